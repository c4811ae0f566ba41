"""The library of effects: one file each, whose law is simulated and fitted."""

from hybrid.effects.effect import Effect as Effect
from hybrid.effects.effect import Port as Port
from hybrid.effects.effect import Scope as Scope
from hybrid.effects.in_plant import Spec as Spec
from hybrid.effects.instant import Memory as Memory
from hybrid.effects.instant import Scalar as Scalar
from hybrid.effects.joint_effect import JointEffect as JointEffect
from hybrid.effects.joint_effect import continued as continued
from hybrid.effects.joint_effect import law_of_fields as law_of_fields
from hybrid.effects.quantity import FASTEST as FASTEST
from hybrid.effects.quantity import Quantity as Quantity
from hybrid.effects.quantity import Scale as Scale
from hybrid.effects.registry import effect_at as effect_at
from hybrid.effects.registry import effect_class as effect_class
from hybrid.effects.registry import effect_classes as effect_classes
from hybrid.effects.registry import effect_from_dict as effect_from_dict
from hybrid.effects.registry import effects_from_file as effects_from_file
from hybrid.effects.registry import effects_from_text as effects_from_text
from hybrid.effects.state import Body as Body
from hybrid.effects.state import JointState as JointState
from hybrid.effects.state import Nominal as Nominal
