"""Find effects of the controller: a late command, or other gains than declared.

They do not show between torque and motion. Here the measured torque is compared with
the torque that a servo law asks for.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Finding
from hybrid.diagnosis.answer.findings import (
    ExtraFindings,
    finding_of,
    fitted_values,
    shrunk,
)
from hybrid.diagnosis.explanations.servo_fit import (
    WORTH,
    Fit,
    fit,
    fit_without_latency,
    hidden_damping,
    log_likelihood_ratio,
)
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import seconds, split, unseen_samples
from hybrid.diagnosis.gap.servo import FEWEST, ServoLog, laws, servo_logs
from hybrid.effects import Effect, Port, effect_at
from hybrid.recording import Recording
from hybrid.signals import Motion
from hybrid.statistics import HALF_WIDTH

_EXPLAINED = 0.95  # least share of the torque's squares that a servo law explains
_CONTROL_PERIOD = 0.002  # s, longest
_LEAST_ERROR = 0.02  # relative, of a gain
_LEAST_FALL = 0.01  # of the squares of the residual


@dataclass(frozen=True, eq=False)
class Link(ExtraFindings):
    """Findings between command and torque."""

    # Squares above noise of the servo laws without the effects found, by block of time,
    # shape (B, n), in units of noise; 0 without findings.
    excess: Array


@dataclass(frozen=True, eq=False)
class _Servo:
    """One joint's servo, fitted with and without each of the two effects."""

    joint: int
    log: ServoLog  # all samples
    test: ServoLog  # the held-out ones
    # On the training samples, by (late, free): whether the command may be late, and
    # whether gains may differ from the declared ones.
    fits: dict[tuple[bool, bool], Fit]
    found: tuple[type[Effect], ...]
    effects: tuple[Effect, ...]  # those found, fitted to all samples
    noise: float  # residual variance of the best fit, [(N·m)²]
    scale: bool  # whether a wrong scale of torque explains as much as other gains

    def without(self, *kinds: type[Effect]) -> Fit:
        """The best fit without some effects."""
        return self.fits[_latency() not in kinds, _gains() not in kinds]

    def decrease(self, before: Fit, after: Fit) -> float:
        """Squares that one fit explains beyond another, in units of noise."""
        squares = float(before.left @ before.left - after.left @ after.left)
        return max(0.0, squares) / self.noise

    def share(self, kind: type[Effect]) -> float:
        """Squares that an effect explains (Shapley value), in units of noise."""
        last = self.decrease(self.without(kind), self.without())
        others = [k for k in self.found if k is not kind]
        first = self.decrease(self.without(*self.found), self.without(*others))
        return (last + first) / 2


def _latency() -> type[Effect]:
    """The effect that the command is late."""
    return effect_at(Port.COMMAND, shifts=True)


def _gains() -> type[Effect]:
    """The effect that the servo has other gains than declared."""
    return effect_at(Port.COMMAND, shifts=False)


def command_link(
    gap: Gap,
    recordings: Sequence[Recording | Motion],
    rng: np.random.Generator,
    *,
    without: Sequence[str] = (),
    distorted: Collection[int] = (),
) -> Link:
    """Find effects between the command and the torque of each joint."""
    # Joints whose torque no servo law explains have no finding; neither have those that
    # are ``distorted``, as their logged torque is not their servo's.
    kinds = [k for k in (_latency(), _gains()) if k.id not in without]
    fitted = [
        _fitted_servo(gap, i, log, kinds)
        for i, log in enumerate(servo_logs(gap, recordings))
        if log is not None and i not in distorted
    ]
    servos = [s for s in fitted if s and s.found and all(map(_plausible, s.effects))]
    squares = np.zeros(gap.robot.size)
    for s in servos:
        squares[s.joint] = sum(map(s.share, s.found))
    found = tuple(
        _finding(gap, [s for s in servos if k in s.found], k, squares.sum(), rng)
        for k in kinds
        if any(k in s.found for s in servos)
    )
    effects = tuple(e for s in servos for e in s.effects)
    return Link(found, effects, squares, _excess(gap, servos))


def _fitted_servo(
    gap: Gap, i: int, log: ServoLog, kinds: Sequence[type[Effect]]
) -> _Servo | None:
    """Fit the servo of a joint; None if no law explains its torque."""
    learn = split(gap)
    test = unseen_samples(gap, learn)
    train, held_out = (log.at(x[log.row]) for x in (learn, test))
    if min(len(train.row), len(held_out.row)) < FEWEST:
        return None
    free, kp, kd = list(laws()), float(gap.robot.kp[i]), float(gap.robot.kd[i])
    declared = list(laws(kp, kd)) if np.isfinite(kp) else []
    whole = fit(train, free, immediate=False)
    tau = held_out.torque(held_out.t)
    left = whole.residual(held_out)
    # A servo pulls towards its command.
    stiffness = whole.gains[1 if whole.law.scaled else 0]
    if left @ left > (1 - _EXPLAINED) * len(tau) * tau.var() or stiffness <= 0:
        return None
    fits = {(True, True): whole, (False, True): fit_without_latency(train, free, whole)}
    found: list[type[Effect]] = []
    # A log may be late by a period.
    least = max(_CONTROL_PERIOD, gap.period)
    late = whole.latency - HALF_WIDTH * whole.latency_std > least
    if late and _better(train, held_out, fit(train, free, immediate=True), whole):
        found.append(_latency())
    scale = False
    if declared:
        alike = [law for law in declared if law.scaled == whole.law.scaled]
        fixed = fits[True, False] = fit(train, alike, immediate=False)
        wrong = _gains_differ(whole, gap, train, i)
        if wrong and _better(train, held_out, fixed, whole):
            found.append(_gains())
            scaled = fit(train, declared, immediate=False)
            scale = log_likelihood_ratio(train, scaled, whole) < WORTH
        elif found:
            # Less damping has the same effect as an earlier command.
            prompt = fit_without_latency(train, declared, fixed)
            if not _better(train, held_out, prompt, fixed):
                found = []
        if len(found) == 2:
            fits[False, False] = fit_without_latency(train, declared, whole)
    noise = float(whole.left @ whole.left) / len(train.row)
    effects = _fitted_effects(gap, i, log, tuple(k for k in found if k in kinds))
    effects = tuple(filter(_is_significant, effects))
    named = tuple(map(type, effects))
    return _Servo(i, log, held_out, fits, named, effects, noise, scale)


def _better(train: ServoLog, held_out: ServoLog, before: Fit, after: Fit) -> bool:
    """Whether a fit is better, on training samples and on held-out samples."""
    first, second = (before.residual(held_out), after.residual(held_out))
    falls = second @ second < (1 - _LEAST_FALL) * (first @ first)
    return bool(falls) and log_likelihood_ratio(train, before, after) > WORTH


def _gain_errors(found: Fit, gap: Gap, i: int) -> tuple[Array, Array]:
    """Relative errors of stiffness and damping, and their standard deviations."""
    # Gains are divided by the scale of the whole torque, if the law has one.
    first = int(found.law.scaled)
    scale = found.gains[0] if first else 1.0
    error, std = np.zeros(2), np.zeros(2)
    for k, gain in enumerate((gap.robot.kp[i], gap.robot.kd[i])):
        if not gain > 0:  # a servo without damping
            continue
        slope, unit = np.zeros(len(found.gains)), gain * scale
        error[k] = found.gains[first + k] / unit - 1.0
        slope[0] = -(error[k] + 1.0) / scale if first else 0.0
        slope[first + k] = 1 / unit
        std[k] = np.sqrt(slope @ found.covariance[2:, 2:] @ slope)
    return error, std


def _gains_differ(found: Fit, gap: Gap, train: ServoLog, i: int) -> bool:
    """Whether gains differ significantly from the declared ones."""
    error, std = _gain_errors(found, gap, i)
    # Noise in the speed hides a part of the damping.
    part = hidden_damping(train, found, gap.rate, gap.cutoff)
    hidden = np.array([0.0, (1.0 + error[1]) * part / max(1.0 - part, 1e-3)])
    sizes = np.maximum(error, -error - hidden)
    return bool((sizes - HALF_WIDTH * std > _LEAST_ERROR).any())


def _is_significant(effect: Effect) -> bool:
    """Whether an interval, from all samples and not the training ones, holds no 0."""
    each = (abs(effect.values[x]) > HALF_WIDTH * std for x, std in effect.std.items())
    return any(each)


def _plausible(effect: Effect) -> bool:
    """Whether the gains of an effect are within their bounds."""
    pairs = zip(effect.gains, effect.gain_values, strict=True)
    return all(g.lower < x < g.upper for g, x in pairs)


def _fitted_effects(
    gap: Gap, i: int, log: ServoLog, kinds: Sequence[type[Effect]]
) -> tuple[Effect, ...]:
    """Fit the effects of a joint to all samples."""
    if not kinds:  # a fit takes time
        return ()
    found = fit(log, list(laws()), immediate=_latency() not in kinds)

    def effect(kind: type[Effect]) -> Effect:
        names = [g.name for g in kind.gains]
        value, std = np.array([found.latency]), np.array([found.latency_std])
        if not kind.shifts:
            value, error = _gain_errors(found, gap, i)
            law = np.array([kind.inexact.get(x, 0.0) for x in names])
            std = np.hypot(error, law * (1.0 + value))
        return kind((i,), *(dict(zip(names, x.tolist(), strict=True))
                            for x in (value, std)))  # fmt: skip

    return tuple(map(effect, kinds))


def _finding(
    gap: Gap,
    servos: Sequence[_Servo],
    kind: type[Effect],
    total: float,
    rng: np.random.Generator,
) -> Finding:
    block, count = seconds(gap), sum(len(s.test.row) for s in servos)
    squares = np.zeros((2, block[-1] + 1))
    for s in servos:
        for k, fitted in enumerate((s.without(kind), s.without())):
            left = fitted.residual(s.test)
            squares[k] += np.bincount(block[s.test.row], left**2, len(squares[k]))
    own = [e for s in servos for e in s.effects if isinstance(e, kind)]
    joints = [s.joint for s in servos]
    return finding_of(
        kind,
        [gap.robot.joints[j] for j in joints],
        kind.at_scale if any(s.scale for s in servos) else (),
        [v for e in own for v in fitted_values(gap, e)],
        share=sum(s.share(kind) for s in servos) / max(total, 1e-300),
        shrink=shrunk(squares, count, gap.robot.chain.unit_at(joints, "N·m"), rng),
    )


def _excess(gap: Gap, servos: Sequence[_Servo]) -> Array:
    block = seconds(gap)
    excess = np.zeros((block[-1] + 1, gap.robot.size))
    for s in servos:
        left = s.without(*s.found).residual(s.log)
        weight = left**2 / s.noise - 1.0
        excess[:, s.joint] = np.bincount(block[s.log.row], weight, len(excess))
    return excess
