"""The link from command to torque: does the servo do what it is thought to do?

Effects of the controller leave no trace between torque and motion. Here the torque
logged is held against the torque that a servo law asks for.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Finding
from hybrid.diagnosis.answer.findings import Beside, found_at, values
from hybrid.diagnosis.answer.intervals import BLOCK_SECONDS, NORMAL, shrink
from hybrid.diagnosis.explanations.servo_fit import (
    WORTH,
    Fit,
    fit,
    fit_without_latency,
    hidden_damping,
    log_likelihood_ratio,
)
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.servo import FEWEST, Law, ServoLog, laws, servo_logs
from hybrid.diagnosis.gap.split import split, unseen_samples
from hybrid.diagnosis.gap.units import units
from hybrid.effects import Effect
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.controller_gain import ControllerGain
from hybrid.recording import Recording
from hybrid.signals import Motion

_EXPLAINED = 0.95  # of the torque's squares, or the servo is of another kind
_HELD = 0.002  # s, for which a controller may hold its command
_LEAST_GAIN = 0.02  # relative error of a gain
_LEAST_FALL = 0.01  # of the squares of what a servo law leaves


@dataclass(frozen=True, eq=False)
class Link(Beside):
    """What the link from command to torque lacks.

    Attributes:
        excess: Squares above noise of the servos as they are thought to be, by block
            of time, shape (B, n), in units of noise; 0 where nothing was found.
    """

    excess: Array


@dataclass(frozen=True, eq=False)
class _Servo:
    """One joint's servo, fitted with and without each of the two effects.

    Attributes:
        joint: The joint.
        log: All its samples.
        test: Those kept for scoring.
        fits: Fits on the others, by (late, off): whether commands may be late, and
            whether gains may be off the declared ones.
        found: Effects found: ``CommandLatency`` and ``ControllerGain``.
        effects: The same with their values from all samples.
        noise: Variance of the torque that no law explains, [(N·m)²].
        scale: Whether a torque logged at another scale would look like other gains.
    """

    joint: int
    log: ServoLog
    test: ServoLog
    fits: dict[tuple[bool, bool], Fit]
    found: tuple[type[Effect], ...]
    effects: tuple[Effect, ...]
    noise: float
    scale: bool

    def without(self, kind: type[Effect]) -> Fit:
        """The best law without one effect."""
        return self.fits[kind is not CommandLatency, kind is not ControllerGain]

    @property
    def thought(self) -> Fit:
        """The servo as it is thought to be, without any effect that was found."""
        return self.fits[
            CommandLatency not in self.found, ControllerGain not in self.found
        ]

    def squares(self, a: Fit, b: Fit) -> float:
        """What one fit leaves more than another, in units of noise."""
        return max(0.0, float(a.left @ a.left - b.left @ b.left)) / self.noise

    def share(self, kind: type[Effect]) -> float:
        """What an effect explains (Shapley), in units of noise."""
        if kind not in self.found:
            return 0.0
        alone = self.squares(self.without(kind), self.fits[True, True])
        if len(self.found) < 2:
            return alone
        other = CommandLatency if kind is ControllerGain else ControllerGain
        return (alone + self.squares(self.thought, self.without(other))) / 2


def command_link(
    gap: Gap,
    recordings: Sequence[Recording | Motion],
    rng: np.random.Generator,
    *,
    without: Sequence[str] = (),
    distorted: Collection[int] = (),
) -> Link:
    """What lies between the command and the torque of each joint.

    Nothing is said of joints whose torque no servo law explains.

    Args:
        gap: The gap.
        recordings: What it was measured from; those with a command are used.
        rng: Draws of the bootstrap.
        without: Ids of effects to leave out.
        distorted: Joints whose logged torque is not what their servo gave: a law of
            it would be of something else.
    """
    learn = split(gap)
    test = unseen_samples(gap, learn)
    kinds = [k for k in (CommandLatency, ControllerGain) if k.id not in without]
    servos = []
    for i, log in enumerate(servo_logs(gap, recordings)):
        if log is not None and i not in distorted:
            servo = _examined(gap, i, log, learn, test, kinds)
            if (
                servo is not None
                and servo.found
                and all(map(_plausible, servo.effects))
            ):
                servos.append(servo)
    squares = np.zeros(gap.robot.size)
    for s in servos:
        squares[s.joint] = sum(map(s.share, s.found))
    found = [
        _finding(gap, own, k, squares.sum(), rng)
        for k in kinds
        if (own := [s for s in servos if k in s.found])
    ]
    effects = tuple(e for s in servos for e in s.effects)
    return Link(tuple(found), effects, squares, _excess(gap, servos))


def _examined(
    gap: Gap,
    i: int,
    log: ServoLog,
    learn: NDArray[np.bool_],
    test: NDArray[np.bool_],
    kinds: Sequence[type[Effect]],
) -> _Servo | None:
    """A joint's servo; nothing if no law explains its torque."""
    own, unseen = log.only(learn), log.only(test)
    if min(len(own.row), len(unseen.row)) < FEWEST:
        return None
    free = list(laws())
    stated = _stated(gap, i)
    whole = fit(own, free, immediate=False)
    tau = unseen.torque(unseen.t)
    left = whole.residual(unseen)
    # A servo pulls towards its command.
    stiffness = whole.gains[1 if whole.law.scaled else 0]
    if left @ left > (1 - _EXPLAINED) * len(tau) * tau.var() or stiffness <= 0:
        return None
    fits = {(True, True): whole, (False, True): fit_without_latency(own, free, whole)}
    found: list[type[Effect]] = []
    # A log may be a period late.
    least = max(_HELD, 1.0 / gap.motions[0].rate)
    late = whole.latency - NORMAL * whole.latency_std > least
    if late and _better(own, unseen, fit(own, free, immediate=True), whole):
        found.append(CommandLatency)
    same = False
    if stated:
        alike = [law for law in stated if law.scaled == whole.law.scaled]
        fits[True, False] = fit(own, alike, immediate=False)
        if _wrong(whole, gap, own, i) and _better(
            own, unseen, fits[True, False], whole
        ):
            found.append(ControllerGain)
            scaled = fit(own, stated, immediate=False)
            same = log_likelihood_ratio(own, scaled, whole) < WORTH
        elif found:
            # Less damping does what a late command undoes; of noise both let less pass.
            thought = fit_without_latency(own, stated, fits[True, False])
            if not _better(own, unseen, thought, fits[True, False]):
                found = []
        if len(found) == 2:
            fits[False, False] = fit_without_latency(own, stated, whole)
    noise = float(whole.left @ whole.left) / len(own.row)
    named = tuple(k for k in found if k in kinds)
    effects = _fitted(gap, i, log, named)
    return _Servo(i, log, unseen, fits, named, effects, noise, same)


def _better(own: ServoLog, unseen: ServoLog, before: Fit, after: Fit) -> bool:
    """Whether a fit is better, on the samples it has seen and on others."""
    squares = [float(x @ x) for x in (before.residual(unseen), after.residual(unseen))]
    falls = squares[1] < (1 - _LEAST_FALL) * squares[0]
    return falls and log_likelihood_ratio(own, before, after) > WORTH


def _stated(gap: Gap, i: int) -> list[Law]:
    kp, kd = gap.robot.kp[i], gap.robot.kd[i]
    return list(laws(float(kp), float(kd))) if np.isfinite(kp) else []


def _off(found: Fit, gap: Gap, i: int) -> tuple[Array, Array]:
    """Relative errors of stiffness and damping, and their standard deviations.

    A free scale of the whole torque, where there is one, is taken out.
    """
    declared = gap.robot.kp[i], gap.robot.kd[i]
    scale = 0 if found.law.scaled else None
    places = (1, 2) if found.law.scaled else (0, 1)
    off, std = np.zeros(2), np.zeros(2)
    for k, (place, gain) in enumerate(zip(places, declared, strict=True)):
        if not gain > 0:  # a servo without damping has none to be off
            continue
        slope = np.zeros(len(found.gains))
        unit = gain if scale is None else gain * found.gains[scale]
        slope[place] = 1 / unit
        off[k] = found.gains[place] / unit - 1.0
        if scale is not None:
            slope[scale] = -(off[k] + 1.0) / found.gains[scale]
        std[k] = np.sqrt(slope @ found.covariance[2:, 2:] @ slope)
    return off, std


def _wrong(found: Fit, gap: Gap, own: ServoLog, i: int) -> bool:
    """Whether gains are surely not the declared ones."""
    off, std = _off(found, gap, i)
    # Of what is there, the part that noise hides comes on top of what is seen.
    part = hidden_damping(own, found, gap.rate, gap.cutoff)
    hidden = np.array([0.0, (1.0 + off[1]) * part / max(1.0 - part, 1e-3)])
    return bool((np.maximum(off, -off - hidden) - NORMAL * std > _LEAST_GAIN).any())


def _plausible(effect: Effect) -> bool:
    """Whether a servo may be off by so much: one beyond follows another law."""
    pairs = zip(effect.gains, effect.gain_values, strict=True)
    return all(g.lower < x < g.upper for g, x in pairs)


def _fitted(
    gap: Gap, i: int, log: ServoLog, kinds: Sequence[type[Effect]]
) -> tuple[Effect, ...]:
    """The effects of a joint with their values from all samples."""
    found = fit(log, list(laws()), immediate=CommandLatency not in kinds)
    effects = []
    for kind in kinds:
        names = [g.name for g in kind.gains]
        value, std = np.array([found.latency]), np.array([found.latency_std])
        if kind is ControllerGain:
            value, spread = _off(found, gap, i)
            law = np.array([kind.inexact.get(x, 0.0) for x in names])
            std = np.hypot(spread, law * (1.0 + value))
        values = (dict(zip(names, x.tolist(), strict=True)) for x in (value, std))
        effects.append(kind((i,), *values))
    return tuple(effects)


def _finding(
    gap: Gap,
    servos: Sequence[_Servo],
    kind: type[Effect],
    total: float,
    rng: np.random.Generator,
) -> Finding:
    block, count = _blocks(gap), sum(len(s.test.row) for s in servos)
    squares = np.zeros((2, block[-1] + 1))
    for s in servos:
        for k, fitted in enumerate((s.without(kind), s.fits[True, True])):
            left = fitted.residual(s.test)
            squares[k] += np.bincount(block[s.test.row], left**2, len(squares[k]))
    alike = kind is ControllerGain and any(s.scale for s in servos)
    own = [e for s in servos for e in s.effects if isinstance(e, kind)]
    joints = [s.joint for s in servos]
    return replace(
        found_at(
            kind,
            [gap.robot.joints[j] for j in joints],
            ControllerGain.at_scale if alike else (),
            [v for e in own for v in values(gap, e)],
        ),
        share=sum(s.share(kind) for s in servos) / max(total, 1e-300),
        shrink={"torque": shrink(squares, count, units(gap.robot, joints)[1], rng)},
    )


def _blocks(gap: Gap) -> NDArray[np.intp]:
    return np.arange(len(gap.fold)) // max(1, round(BLOCK_SECONDS * gap.rate))


def _excess(gap: Gap, servos: Sequence[_Servo]) -> Array:
    block = _blocks(gap)
    excess = np.zeros((block[-1] + 1, gap.robot.size))
    for s in servos:
        left = s.thought.residual(s.log)
        weight = left**2 / s.noise - 1.0
        excess[:, s.joint] = np.bincount(block[s.log.row], weight, len(excess))
    return excess
