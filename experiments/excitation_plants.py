"""Plants for designed motions to be tried on, and random motions to beat."""

from pathlib import Path

from excitation_arms import arm
from improved_stribeck_law import ImprovedStribeck

from hybrid.effects.asymmetric_friction import AsymmetricFriction
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.presliding import Presliding
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.excitation import Fourier
from hybrid.excitation.constraints import TorqueLimits
from hybrid.excitation.experiments import path_from_reference
from hybrid.plant import Plant, Reference, load_truth
from hybrid.plant.reference import random_fourier
from hybrid.plant.scale import joint_scales

FAMILY, FILL = Fourier(5, 0.1), 0.8  # of all motions; of the limits
# What a joint of a drawn plant has or not, and the range of its shape. Sizes are a
# quarter of the usual ones and up.
KINDS = (
    (ImprovedStribeck, "velocity", 0.02, 0.1),
    (Presliding, "distance", 0.002, 0.01),
    (LoadFriction, "", 0, 0),
    (AsymmetricFriction, "", 0, 0),
    (TorqueRipple, "periods", 1, 6),
    (TorqueRipple, "periods", 30, 200),
)
TRUTH = Path(__file__).parents[1] / "models/coman_truth.yaml"


def plant_for(name, rng):
    """The nominal arm of that name and its plant, drawn but for the documented one."""
    return load_truth(TRUTH) if name == "coman_like" else drawn(arm(name), rng)


def random(robot, rate, rng):
    """A random motion that touches a limit of each joint, torque included."""
    x = random_fourier(
        robot, duration=FAMILY.duration, rate=rate, seed=rng, fill=FILL,
        fundamental=FAMILY.fundamental, order=FAMILY.order,
    )  # fmt: skip
    middle = (x.q.max(axis=0) + x.q.min(axis=0)) / 2
    torque = TorqueLimits(robot, FILL * robot.tau_max)
    while (torque.excess(path_from_reference(x)) > 0).any():
        x = Reference(x.t, middle + 0.95 * (x.q - middle), 0.95 * x.v, 0.95 * x.a)
    return x


def drawn(robot, rng):
    """The arm, and a plant whose links and drives differ from it, each in its way."""
    factors = rng.uniform(0.8, 1.2, (robot.size, 1))
    effects, scales = [], joint_scales(robot)
    for j in range(robot.size):
        for kind, shape, lowest, highest in KINDS:
            shapes = {shape: rng.uniform(lowest, highest)} if shape else {}
            usual = kind.typical((j,), scales, **shapes)
            part = rng.uniform(0.25, 1.0) * (rng.random() < 0.5)
            gains = {g.name: part * usual.values[g.name] for g in usual.gains}
            effects += [usual.at(gains)] if part else []
    links = robot.with_inertial(robot.chain.inertial * factors)
    return robot, Plant(links, effects, nominal=robot)
