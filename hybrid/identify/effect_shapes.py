"""Gains and shapes of effects from the torque that the rest of a model leaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.effects import Effect, Scale
from hybrid.effects.effect import Body
from hybrid.errors import IdentificationError
from hybrid.identify.cross_products import moving_samples
from hybrid.identify.separable import SeparableFit, fit_separable
from hybrid.identify.separable_problem import SeparableProblem
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler

_BLOCKS = 384


@dataclass(frozen=True)
class Log:
    """One motion and what is to be explained along it.

    Attributes:
        motion: N samples at full rate; those its mask leaves out do not count.
        body: Rigid-body quantities along it.
        rest: Torque that the effects, and ``rigid``, shall explain, shape (N, n),
            [N·m].
        rigid: Columns of further unknowns without bounds, such as base inertial
            parameters, shape (N, n, m), or None.
    """

    motion: Motion
    body: Body
    rest: Array
    rigid: Array | None = None


@dataclass(frozen=True)
class EffectFit:
    """Fitted effects.

    Attributes:
        effects: The effects with their values and standard deviations.
        separable: The solution: shapes of all effects in order, then their gains.
        names: (effect, parameter) of each shape, then of each gain.
        rms: What is left at each joint over the samples used, shape (n,), [N·m]; NaN
            where none of the unknowns acts.
    """

    effects: tuple[Effect, ...]
    separable: SeparableFit
    names: tuple[tuple[int, str], ...]
    rms: Array

    def interval(
        self, level: float = 0.95
    ) -> dict[tuple[int, str], tuple[float, float]]:
        """Confidence interval of every parameter, by index of the effect and name."""
        low, high = self.separable.interval(level)
        ends = zip(low.tolist(), high.tolist(), strict=True)
        return dict(zip(self.names, ends, strict=True))


@dataclass(frozen=True)
class _Stack:
    """Columns of effects over logs: filtered, decimated, moving samples only."""

    effects: tuple[Effect, ...]
    logs: tuple[Log, ...]
    cutoff: float
    standing: Array
    joints: tuple[int, ...]
    weight: Array
    _kept: dict[tuple[int, int], dict[tuple[float, ...], Array]] = field(
        default_factory=dict, init=False
    )

    @cached_property
    def samplers(self) -> tuple[Sampler, ...]:
        return tuple(Sampler.for_rate(x.motion.rate, self.cutoff) for x in self.logs)

    @cached_property
    def used(self) -> tuple[NDArray[np.bool_], ...]:
        """Samples that count, shape (M, joints) for each log."""
        pairs = zip(self.logs, self.samplers, strict=True)
        return tuple(
            moving_samples(x.motion, sampler, self.standing)[:, list(self.joints)]
            for x, sampler in pairs
        )

    def rows(self, values: Sequence[Array]) -> Array:
        """Rows of signals (M, n, …), one for each log, in the order of the target."""
        joints = list(self.joints)
        scale = self.weight[joints].reshape(-1, *(1,) * (values[0].ndim - 2))
        parts = zip(values, self.used, strict=True)
        return np.concatenate([(x[:, joints] * scale)[used] for x, used in parts])

    def filtered(self, values: Sequence[Array]) -> list[Array]:
        return [s(x) for s, x in zip(self.samplers, values, strict=True)]

    def columns(self, shapes: Array) -> Array:
        """Columns of every gain, shape (rows, p)."""
        effects = _shaped(self.effects, shapes)
        gains = [len(effect.gains) for effect in effects]
        starts = np.cumsum([0, *gains])
        parts = []
        for r, log in enumerate(self.logs):
            n = log.rest.shape[1]
            samples = len(self.used[r])
            out = np.zeros((samples, n, starts[-1]))
            for e, effect in enumerate(effects):
                own = slice(starts[e], starts[e + 1])
                at = list(effect.reaches(n))
                out[:, at, own] = self._effect_columns(r, e, effect)
            parts.append(out)
        return self.rows(parts)

    def _effect_columns(self, r: int, e: int, effect: Effect) -> Array:
        """Filtered columns; kept for the last two: a point and a step from it."""
        key = tuple(effect.shape_values.values())
        kept = self._kept.setdefault((r, e), {})
        if key not in kept:
            log = self.logs[r]
            kept[key] = self.samplers[r](effect.columns(log.motion, log.body))
            if len(kept) > 2:
                del kept[next(iter(kept))]
        else:
            kept[key] = kept.pop(key)  # the youngest again
        return kept[key]

    def blocks(self) -> NDArray[np.intp]:
        """Block of time of every row, of one length in all logs."""
        total = sum(len(used) for used in self.used)
        length = max(1, total // _BLOCKS)
        found, first = [], 0
        for used in self.used:
            number = first + np.arange(len(used)) // length
            found.append(np.broadcast_to(number[:, None], used.shape)[used])
            first = int(number[-1]) + 1
        return np.unique(np.concatenate(found), return_inverse=True)[1]


def fit_effects(
    effects: Sequence[Effect],
    logs: Sequence[Log],
    *,
    scales: Sequence[Scale],
    cutoff: float = np.inf,
    standing: Array | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 16,
) -> EffectFit:
    """Fit gains and shapes of effects, all at once.

    Shapes stay within the bounds that the effects state; gains that are physically
    non-negative stay so. Joints that no effect couples are fitted one by one, each with
    ``rigid`` unknowns of its own; from there all are fitted together, each weighed by
    its own residual.

    Args:
        effects: Effects; the values of their shapes are the first guess.
        logs: Motions with the torque to explain.
        scales: Size of every joint of the arm.
        cutoff: Columns and torque are filtered at this frequency alike, [Hz].
        standing: Speed below which a joint stands and does not count, shape (n,),
            [rad/s]; 0 by default.
        bounds: Bounds by name of a gain or shape, in place of those.
        starts: Points of a Sobol set that are tried as starts.

    Raises:
        IdentificationError: There is nothing to fit, or nothing moves.
    """
    if not effects or not logs:
        raise IdentificationError("one effect and one log or more are needed")
    n = logs[0].rest.shape[1]
    still = np.zeros(n) if standing is None else standing
    effects, weight = list(effects), np.ones(n)
    everything = _Stack(
        tuple(effects), tuple(logs), cutoff, still, tuple(range(n)), weight
    )
    limit = partial(_limits, scales=scales, bounds=dict(bounds or {}))
    for joints in _groups(effects, n):
        own = [e for e, x in enumerate(effects) if x.reaches(n)[0] in joints]
        some = tuple(effects[e] for e in own)
        stack = replace(everything, effects=some, joints=joints)
        found = fit_separable(_problem(stack, limit), start=_start(some), starts=starts)
        fit = _with_values(stack, found)
        for e, effect in zip(own, fit.effects, strict=True):
            effects[e] = effect
        known = fit.rms[list(joints)]
        weight[list(joints)] = 1.0 / np.where(known > 0, known, 1.0)
        if len(own) == len(effects) and logs[0].rigid is None:
            return fit
    coupled = any(log.rigid is not None for log in logs)
    used = range(n) if coupled else sorted({j for e in effects for j in e.reaches(n)})
    stack = replace(everything, effects=tuple(effects), joints=tuple(used))
    found = fit_separable(_problem(stack, limit), start=_start(effects), starts=0)
    return _with_values(stack, found)


def _groups(effects: Sequence[Effect], size: int) -> list[tuple[int, ...]]:
    """Joints of an arm of some size that effects couple, in groups."""
    groups: list[set[int]] = []
    for effect in effects:
        joined = set(effect.reaches(size))
        joined = joined.union(*(g for g in groups if g & joined))
        groups = [g for g in groups if not g & joined] + [joined]
    return [tuple(sorted(g)) for g in groups]


def _start(effects: Sequence[Effect]) -> Array:
    return np.array([x for e in effects for x in e.shape_values.values()])


def _problem(
    stack: _Stack, limit: Callable[[Sequence[Effect]], tuple[Array, ...]]
) -> SeparableProblem:
    target = stack.rows(stack.filtered([log.rest for log in stack.logs]))
    lower, upper, gain_lower, gain_upper = limit(stack.effects)
    return SeparableProblem(
        columns=stack.columns,
        target=target,
        lower=lower,
        upper=upper,
        gain_lower=gain_lower,
        gain_upper=gain_upper,
        free=_rigid(stack),
        block=stack.blocks(),
    )


def _shaped(effects: Sequence[Effect], shapes: Array) -> list[Effect]:
    """The effects with other shapes, given in order."""
    found, first = [], 0
    for effect in effects:
        names = [s.name for s in effect.shapes]
        own = shapes[first : first + len(names)].tolist()
        found.append(effect.at(dict(zip(names, own, strict=True))) if names else effect)
        first += len(names)
    return found


def _limits(
    effects: Sequence[Effect],
    scales: Sequence[Scale],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[Array, Array, Array, Array]:
    """Lower and upper bounds of shapes, then of gains."""
    shapes, gains = [], []
    for effect in effects:
        scale = scales[effect.joints[-1]]
        for s in effect.shapes:
            own = s.scaled(scale)
            shapes.append(bounds.get(s.name, (own.lower, own.upper)))
        for g in effect.gains:
            usual = (0.0 if g.lower >= 0 else -np.inf, np.inf)
            gains.append(bounds.get(g.name, usual))
    s_bounds = np.array(shapes, dtype=float).reshape(-1, 2).T
    g_bounds = np.array(gains, dtype=float).reshape(-1, 2).T
    return s_bounds[0], s_bounds[1], g_bounds[0], g_bounds[1]


def _rigid(stack: _Stack) -> Array | None:
    columns = [log.rigid for log in stack.logs if log.rigid is not None]
    if not columns:
        return None
    if len(columns) < len(stack.logs):
        raise IdentificationError("give rigid columns for every log or for none")
    return stack.rows(stack.filtered(columns))


def _rms(stack: _Stack, residual: Array) -> Array:
    """Residual of each joint without its weight, shape (n,), [N·m]."""
    squares, counts = np.zeros((2, len(stack.weight)))
    joint = np.concatenate(
        [np.broadcast_to(stack.joints, used.shape)[used] for used in stack.used]
    )
    np.add.at(squares, joint, (residual / stack.weight[joint]) ** 2)
    np.add.at(counts, joint, 1.0)
    mean = squares / np.maximum(counts, 1.0)
    return np.where(counts > 0, np.sqrt(mean), np.nan)


def _with_values(stack: _Stack, found: SeparableFit) -> EffectFit:
    effects = stack.effects
    names = [(e, s.name) for e, effect in enumerate(effects) for s in effect.shapes]
    names += [(e, g.name) for e, effect in enumerate(effects) for g in effect.gains]
    values = np.concatenate([found.shapes, found.gains]).tolist()
    std = np.where(found.at_bound, np.nan, found.std).tolist()
    fitted = []
    for e, effect in enumerate(effects):
        rows = [k for k, (at, _) in enumerate(names) if at == e]
        fitted.append(
            effect.at(
                {names[k][1]: values[k] for k in rows},
                {names[k][1]: std[k] for k in rows},
            )
        )
    return EffectFit(tuple(fitted), found, tuple(names), _rms(stack, found.residual))
