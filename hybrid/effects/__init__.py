"""The library of effects: one file each, whose law is simulated and fitted."""

from hybrid.effects.effect import Effect, Port, Scope
from hybrid.effects.in_plant import Spec
from hybrid.effects.instant import Memory, Scalar
from hybrid.effects.joint_effect import JointEffect, continued, law_of_fields
from hybrid.effects.quantity import FASTEST, Quantity, Scale
from hybrid.effects.state import Body, JointState, Nominal

__all__ = [
    "FASTEST",
    "Body",
    "Effect",
    "JointEffect",
    "JointState",
    "Memory",
    "Nominal",
    "Port",
    "Quantity",
    "Scalar",
    "Scale",
    "Scope",
    "Spec",
    "continued",
    "effect_at",
    "effect_class",
    "effect_classes",
    "effect_from_dict",
    "effects_from_file",
    "effects_from_text",
    "law_of_fields",
]

from hybrid.effects.registry import (
    effect_at,
    effect_class,
    effect_classes,
    effect_from_dict,
    effects_from_file,
    effects_from_text,
)
