"""Design of excitation motions for the identification of an arm."""

from hybrid.excitation.clearance import Clearance as Clearance
from hybrid.excitation.clearance import Floor as Floor
from hybrid.excitation.constraints import Limits as Limits
from hybrid.excitation.criteria import Condition as Condition
from hybrid.excitation.criteria import DOptimal as DOptimal
from hybrid.excitation.design import Design as Design
from hybrid.excitation.design import design as design
from hybrid.excitation.experiments import at_speeds as at_speeds
from hybrid.excitation.experiments import micro_reversals as micro_reversals
from hybrid.excitation.experiments import multisine as multisine
from hybrid.excitation.experiments import speed_ladder as speed_ladder
from hybrid.excitation.experiments import static_poses as static_poses
from hybrid.excitation.families import Fourier as Fourier
from hybrid.excitation.families import Spline as Spline
from hybrid.excitation.observation import observe as observe
