"""What the benchmarks time: one identification of the shipped six-axis arm.

84 columns a sample (60 inertial, and armature, Coulomb, viscous and offset of each
joint), every sample used: no filter, no decimation. Nothing is printed.
"""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np

from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.dynamics.regressor import inverse_dynamics
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.identification import DynamicModel
from hybrid.regression.cross_products import accumulate
from hybrid.regression.data import Data
from hybrid.regression.intervals import Estimate, with_uncertainty
from hybrid.regression.least_squares import solve_weighted
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

ARM = Path(__file__).parents[1] / "models" / "coman_like.xml"
_RATE = 1000.0  # Hz


def random_motion(robot: Robot, samples: int) -> Motion:
    """Tones on every joint, with the torque of the arm, dry friction and noise."""
    rng = np.random.default_rng(0)
    n, t = robot.size, np.arange(samples) / _RATE
    q, v, a = (np.zeros((samples, n)) for _ in range(3))
    for frequency in rng.uniform(0.5, 6.0, (6, n)):
        phase = rng.uniform(0, 2 * np.pi, n)
        angle = np.outer(t, frequency) + phase
        wave = 0.4 * np.sin(angle)
        q += wave
        v += 0.4 * frequency * np.cos(angle)
        a -= frequency**2 * wave
    tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a)
    mixing = 0.2 * (np.eye(n) + 0.7 * np.eye(n, k=1))  # noise shared by neighbours
    tau += np.sign(v) + rng.standard_normal((samples, n)) @ mixing
    return Motion(t, q, v, a, tau, np.ones(samples, dtype=bool), joints=robot.joints)


def plain_effects(robot: Robot) -> tuple[Effect, ...]:
    """Linear friction, rotor and offset of each joint."""
    kinds = (Armature, Coulomb, Viscous, TorqueOffset)
    return tuple(kind((j,)) for kind in kinds for j in range(robot.size))


def identify_plainly(robot: Robot, motion: Motion) -> tuple[Estimate, dict[str, float]]:
    """Regressor, reduction, reweighted least squares to convergence, and intervals.

    Returns:
        The estimate, and the seconds of each step by name.
    """
    times = [process_time()]
    problem = build_problem(robot.chain, plain_effects(robot))
    assert problem.support  # worked out once for each arm
    times.append(process_time())
    fold = np.zeros(len(motion.t), dtype=np.intp)
    data = Data((motion,), (fold,), np.inf, np.zeros(robot.size))
    products = accumulate(problem, data)
    times.append(process_time())
    estimate = with_uncertainty(products, solve_weighted(products, "irls"))
    times.append(process_time())
    names = ("reduction", "columns and cross-products", "IRLS and intervals")
    return estimate, dict(zip(names, np.diff(times).tolist(), strict=True))


def full_model(robot: Robot, motion: Motion) -> DynamicModel:
    """A model with every kind of term on every joint, its numbers made up."""
    joints, rng = range(robot.size), np.random.default_rng(0)
    kinds = (Armature, ThresholdFriction, LoadFriction, TorqueRipple)
    effects = [kind((j,)) for kind in kinds for j in joints]
    effects = [e.at({g.name: 0.1 for g in e.gains}) for e in effects]
    few = rng.choice(len(motion.t), 2000)
    parts = []
    for j in joints:
        x = np.column_stack([motion.q[few, j], motion.v[few, j]])
        regression = fit_gmr(
            x, rng.standard_normal((len(few), 1)), components=8, seed=0
        )
        parts.append(JointRemainder(j, (j,), (j,), regression))
    base = build_problem(robot.chain, ()).base
    remainder = ArmRemainder(robot.size, tuple(parts))
    return DynamicModel(robot, base, tuple(effects), remainder)
