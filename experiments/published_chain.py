"""The three-stage identification of the literature, as printed.

1. Rigid body with rotors and linear friction: least squares (LS), weighted by the
   variance of each joint (WLS), reweighted by the full covariance across joints (IRLS).
2. Friction of each joint from the torque that its rigid body leaves: five non-negative
   gains by non-negative least squares, two Coulomb levels of opposite direction, v³, v²
   and v, all in the direction of motion. Speeds below a threshold λ have gains of their
   own; they are fitted first, then those above. λ is settled by what both leave.
3. Gaussian-mixture regression of the torque then left, over position and speed of the
   joint; the number of components by BIC.

All three are repeated on the torque less what the others explain until it settles.
Nothing is held out in the chain, and no stage is refused. Where the print is silent: λ
is a quantile of the speed; mixtures learn from samples 0.1 s apart, which hardly repeat
each other, as BIC takes all for independent (from all samples it takes 32 components,
the most there are, and errs more); they fade to zero outside their data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hybrid import Motion, Recording, Robot
from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.effects import Effect, JointEffect, JointState, Port, Quantity
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.identification import DynamicModel
from hybrid.identification.preparation import checked_logs, prepare
from hybrid.regression.cross_products import accumulate
from hybrid.regression.data import Data
from hybrid.regression.least_squares import ESTIMATORS, Estimator, solve_weighted
from hybrid.regression.problem import build_problem
from hybrid.signals import Sampler

COMPONENTS = (1, 2, 4, 8, 16, 32)
_CANDIDATES = 24  # thresholds tried at a time: quantiles of the speed
_MOST_ROUNDS, _SETTLED = 10, 0.005  # relative change of what is left
_APART = 0.1  # s between the samples that mixtures learn from
PLAIN = tuple(name.upper() for name in ESTIMATORS)
_LINEAR = (TorqueOffset, Coulomb, Viscous)
_GAINS = ("coulomb_positive", "coulomb_negative", "cubic", "quadratic", "linear")


def _gain(regime: str, name: str) -> Quantity:
    order = {"cubic": 3, "quadratic": 2, "linear": 1}.get(name, 0)
    unit = ("N·m", "N·m·s/rad", "N·m·s²/rad²", "N·m·s³/rad³")[order]
    return Quantity(f"{regime}_{name}", unit, 0.02, 0.0, 1.0, per=(1, -order))


class RegimeFriction(JointEffect):
    """Friction of two speed regimes with five gains each; it jumps at λ, as printed."""

    id = "regime_friction"
    port = Port.DRIVE
    dry = True
    gains = tuple(_gain(r, name) for r in ("slow", "fast") for name in _GAINS)
    shapes = (Quantity("threshold", "rad/s", 0.2, 0.0, 100.0),)
    equation = "τ = σ(v) (k_c± + k_3 |v|³ + k_2 v² + k_1 |v|), other k below λ"
    source = "the published chain; Lawson and Hanson 1974, doi 10.1137/1.9781611971217"
    sentence = "Friction of {joints} has one law below a speed and another above."
    remedy = "Give the joint a friction table over speed."

    @staticmethod
    def law(state: JointState, **shapes: Any) -> Sequence[Array]:
        """Torque per unit of each gain."""
        columns, slow = five(state.sign, state.v), abs(state.v) < shapes["threshold"]
        below = [np.where(slow, x, 0.0) for x in columns]
        return (*below, *(np.where(slow, 0.0, x) for x in columns))


def five(sign: Array, v: Array) -> tuple[Array, ...]:
    """Torque per unit of each of the five gains."""
    positive, negative = np.where(sign > 0, sign, 0.0), np.where(sign < 0, sign, 0.0)
    return positive, negative, v**3, v * abs(v), v


@dataclass(frozen=True)
class Chain:
    """What the chain made.

    Attributes:
        models: Model after each stage, by its name.
        components: Components of each joint's mixture.
        thresholds: λ of each joint, [rad/s].
        rounds: How often the three stages were gone through.
        settled: False if the limit of rounds came first.
    """

    models: dict[str, DynamicModel]
    components: tuple[int, ...]
    thresholds: tuple[float, ...]
    rounds: int
    settled: bool


def published_chain(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    effects: Sequence[Effect] = (),
    cutoff: float | None = None,
    seed: int = 0,
) -> Chain:
    """Run the chain on logs of an arm.

    Args:
        robot: The arm.
        recordings: Logs to fit on.
        effects: Terms of the rigid body beyond its rotors.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
        seed: Seed of the mixtures' starts.
    """
    data, joints = prepare(checked_logs(robot, recordings), cutoff), range(robot.size)
    rotors = [*(Armature((j,)) for j in joints), *effects]
    linear = [cls((j,)) for cls in _LINEAR for j in joints]
    everything = [*rotors, *linear]
    models = {name.upper(): rigid(robot, data, everything, name) for name in ESTIMATORS}
    body, size = _only(models["IRLS"], rotors), np.inf
    learned: ArmRemainder | None = None
    for rounds in range(1, _MOST_ROUNDS + 1):  # noqa: B007
        bent, model = later_stages(data, body, learned, seed)
        models.setdefault("published + friction", bent)
        models.setdefault("published + mixture", model)
        before, size = size, left_by(model, data).rms
        if settled := before - size < _SETTLED * size:
            break
        known = [model.predict(m) - body.predict(m) for m in data.motions]
        body, learned = rigid(robot, data, rotors, "irls", known), model.remainder
    models["published, iterated"] = model
    laws = [e for e in model.effects if isinstance(e, RegimeFriction)]
    thresholds = tuple(law.values["threshold"] for law in laws)
    return Chain(models, components(model.remainder), thresholds, rounds, settled)


def later_stages(
    data: Data, body: DynamicModel, learned: ArmRemainder | None, seed: int
) -> tuple[DynamicModel, DynamicModel]:
    """Friction around a rigid body and what was learned; and the mixtures anew.

    Args:
        data: What to fit on.
        body: Stage one alone.
        learned: Mixtures of the round before; their sizes stay.
        seed: Seed of the mixtures' starts.

    Returns:
        The model with friction, and with friction and mixtures.
    """
    joints = range(body.robot.size)
    rest = left_by(replace(body, remainder=learned), data)
    friction = (threshold_friction(data, rest, j) for j in joints)
    bent = replace(body, effects=(*body.effects, *friction))
    counts = components(learned) if learned else [None for _ in joints]
    return bent, replace(bent, remainder=mixtures(left_by(bent, data), counts, seed))


def components(learned: ArmRemainder) -> tuple[int, ...]:
    """How many components each joint's mixture has."""
    return tuple(part.regression.components for part in learned.parts)


def beside(chain: Chain, ours: DynamicModel) -> dict[str, DynamicModel]:
    """Models of the chain, then the rungs of our ladder below its last, by name."""
    return chain.models | {k: x for k, x in ours.simpler.items() if k not in PLAIN}


def rigid(
    robot: Robot,
    data: Data,
    effects: Sequence[Effect],
    estimator: Estimator,
    explained: Sequence[Array] = (),
) -> DynamicModel:
    """Stage one: base parameters and the gains of effects that are linear in them.

    Args:
        robot: The arm.
        data: What to fit on.
        effects: Effects whose gains are unknown.
        estimator: How joints are weighed.
        explained: Torque that the other stages explain, shape (N, n) for each motion,
            [N·m].
    """
    problem = build_problem(robot.chain, effects)
    products = accumulate(problem, data.minus(explained or None))
    base, found = problem.fitted(solve_weighted(products, estimator).theta)
    return DynamicModel(robot, base, found, None, data.cutoff, data.standing)


@dataclass(frozen=True)
class Rest:
    """Torque that a model leaves, M filtered and decimated samples of all motions.

    Attributes:
        q: Positions, shape (M, n), [rad].
        v: Speeds, shape (M, n), [rad/s].
        tau: Torque left, shape (M, n), [N·m].
        moving: Where each joint moves and the mask allows, shape (M, n).
        rate: Samples per second, [Hz].
    """

    q: Array
    v: Array
    tau: Array
    moving: NDArray[np.bool_]
    rate: float

    @property
    def rms(self) -> float:
        """RMS of moving samples, mean over the joints, [N·m]."""
        squares = np.where(self.moving, self.tau**2, 0.0).sum(axis=0)
        return float(np.sqrt(squares / self.moving.sum(axis=0)).mean())


def left_by(model: DynamicModel, data: Data) -> Rest:
    """What a model leaves of the torque it is fitted to."""
    parts = []
    for motion in data.motions:
        sampler = Sampler.for_rate(motion.rate, data.cutoff)
        q, v = motion.q[:: sampler.factor], motion.v[:: sampler.factor]
        moving = (np.abs(v) > data.standing) & sampler.keep(motion.mask)[:, None]
        parts.append((q, v, sampler(motion.tau - model.predict(motion)), moving))
    rate = motion.rate / sampler.factor
    return Rest(*(np.concatenate(x) for x in zip(*parts, strict=True)), rate)


def _only(model: DynamicModel, effects: Sequence[Effect]) -> DynamicModel:
    """The model with its effects of the same kinds as these alone."""
    kinds = {type(effect) for effect in effects}
    return replace(model, effects=tuple(e for e in model.effects if type(e) in kinds))


def threshold_friction(data: Data, rest: Rest, joint: int) -> RegimeFriction:
    """Stage two: friction of one joint from what the rigid body leaves of its torque.

    Args:
        data: What to fit on.
        rest: Torque left.
        joint: The joint.
    """
    columns = []
    for motion in data.motions:
        v, sampler = motion.v[:, joint], Sampler.for_rate(motion.rate, data.cutoff)
        columns.append(sampler(np.stack(five(np.sign(v), v), axis=1)))
    moving = rest.moving[:, joint]
    threshold, gains = regimes(
        np.abs(rest.v[moving, joint]),
        np.concatenate(columns)[moving],
        rest.tau[moving, joint],
    )
    names = [g.name for g in RegimeFriction.gains]
    values = dict(zip(names, gains, strict=True)) | {"threshold": threshold}
    return RegimeFriction((joint,), values)


def regimes(speed: Array, columns: Array, tau: Array) -> tuple[float, Array]:
    """Threshold and non-negative gains of slow and fast samples.

    Args:
        speed: Absolute speed, shape (M,), [rad/s].
        columns: Torque per unit of each of the five gains, shape (M, 5).
        tau: Torque to explain, shape (M,), [N·m].

    Returns:
        λ [rad/s], and the gains below it, then those above, shape (10,).
    """
    low, high = 0.0, 1.0  # shares of the samples
    for _ in range(2):  # coarsely, then between the neighbours of the best
        found = []
        for share in np.linspace(low, high, _CANDIDATES + 2)[1:-1]:
            threshold = np.quantile(speed, share)
            slow = speed < threshold
            parts = [nnls(columns[part], tau[part]) for part in (slow, ~slow)]
            gains = np.concatenate([x for x, _ in parts])
            squares = sum(left**2 for _, left in parts)
            found.append((squares, share, float(threshold), gains))
        _, share, threshold, gains = min(found, key=lambda x: x[0])
        step = (high - low) / (_CANDIDATES + 1)
        low, high = share - step, share + step
    return threshold, gains


def mixtures(rest: Rest, counts: Sequence[int | None], seed: int) -> ArmRemainder:
    """Stage three: a mixture of every joint over what is left of its torque.

    Args:
        rest: Torque left.
        counts: Components of each joint, or None to choose them by BIC.
        seed: Seed of the starts.
    """
    n, parts = rest.tau.shape[1], []
    apart = max(1, round(_APART * rest.rate))
    for joint, count in enumerate(counts):
        moving = np.flatnonzero(rest.moving[:, joint])[::apart]
        regression = fit_gmr(
            np.stack([rest.q[moving, joint], rest.v[moving, joint]], axis=1),
            rest.tau[moving, joint, None],
            components=COMPONENTS if count is None else count,
            seed=seed,
        )
        parts.append(JointRemainder(joint, (joint,), (joint,), regression))
    return ArmRemainder(n, tuple(parts))
