"""A diagnosis that several test files share; it is made once."""

from functools import cache

from coarse import Plant, simulate
from simulated import arm

from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.diagnose import examine
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple

RIPPLE = TorqueRipple((0,), {"sine": 1.5, "cosine": -1.0, "periods": 10.0})
STRIBECK = Stribeck((1,), {"level": 1.5, "velocity": 0.1})


@cache
def planar() -> Result:
    """A planar arm with a ripple at its shoulder and Stribeck friction at its elbow."""
    plant = Plant(arm("planar"), [RIPPLE, STRIBECK])
    recordings = simulate(plant, trajectories=4, duration=6.0, seed=0)
    return examine(plant.robot, recordings)


@cache
def faultless() -> Result:
    """The same arm as its simulator has it."""
    plant = Plant(arm("planar"), [])
    return examine(plant.robot, simulate(plant, trajectories=4, duration=6.0, seed=0))
