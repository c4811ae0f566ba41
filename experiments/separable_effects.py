"""Gains and shapes of effects, all at once, from the torque that a model leaves.

See ``separable.py``. Nothing here prints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from separable import Fit, Problem, fit_separable

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Scale
from hybrid.errors import IdentificationError
from hybrid.signals import Motion, Sampler

_BLOCKS = 384


@dataclass(frozen=True)
class Log:
    """One motion and what is to be explained along it.

    Attributes:
        motion: N samples; those that its mask leaves out do not count.
        body: Rigid-body quantities along it.
        rest: Torque to explain, shape (N, n), [N·m].
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
        rms: What is left at each joint over the samples used, shape (n,), [N·m]; NaN
            where none of the unknowns acts.
    """

    effects: tuple[Effect, ...]
    separable: Fit
    rms: Array

    def interval(self, level: float = 0.95) -> dict[tuple[int, str], list[float]]:
        """Confidence interval of every parameter, by index of the effect and name."""
        ends = np.transpose(self.separable.interval(level)).tolist()
        return dict(zip(_names(self.effects), ends, strict=True))


@dataclass(frozen=True)
class _Rows:
    """What the logs say, filtered and decimated: a row for every joint that moves."""

    effects: Sequence[Effect]
    logs: Sequence[Log]
    cutoff: float

    @cached_property
    def samplers(self) -> list[Sampler]:
        return [Sampler.for_rate(x.motion.rate, self.cutoff) for x in self.logs]

    @cached_property
    def used(self) -> list[NDArray[np.bool_]]:
        """Samples that count, shape (M, n) for each log."""
        each = zip(self.logs, self.samplers, strict=True)
        speeds = [(x.motion.v[:: s.factor], s.keep(x.motion.mask)) for x, s in each]
        return [(v != 0.0) & keep[:, None] for v, keep in speeds]

    def of(self, signals: Iterable[Array]) -> Array:
        """Rows of signals at full rate, shape (N, n, …) for each log."""
        each = zip(signals, self.samplers, self.used, strict=True)
        return np.concatenate([sampler(x)[used] for x, sampler, used in each])

    @cached_property
    def given(self) -> tuple[Array, Array | None]:
        """Rows of the torque to explain and of the further columns."""
        rigid = [x.rigid for x in self.logs if x.rigid is not None]
        if 0 < len(rigid) < len(self.logs):
            raise IdentificationError("give rigid columns for every log or for none")
        return self.of(x.rest for x in self.logs), self.of(rigid) if rigid else None

    @cached_property
    def joint(self) -> NDArray[np.intp]:
        """Joint of each row."""
        return np.concatenate([used.nonzero()[1] for used in self.used])

    @cached_property
    def block(self) -> NDArray[np.intp]:
        """Block of time of each row, of one length in all logs."""
        count = sum(map(len, self.used))
        length = max(1, count // _BLOCKS)
        each = [used.nonzero()[0] // length for used in self.used]
        return np.concatenate([r * count + x for r, x in enumerate(each)])

    @cached_property
    def columns(self) -> Callable[[int, tuple[float, ...]], Array]:
        """Rows of an effect's columns at some shapes; the last ones are kept."""

        def found(e: int, shapes: tuple[float, ...]) -> Array:
            names, parts = (s.name for s in self.effects[e].shapes), []
            effect = self.effects[e].at(dict(zip(names, shapes, strict=True)))
            for x, sampler, used in zip(
                self.logs, self.samplers, self.used, strict=True
            ):
                part = np.zeros((*used.shape, len(effect.gains)))
                at = list(effect.reaches(used.shape[1]))
                part[:, at] = sampler(effect.columns(x.motion, x.body))
                parts.append(part[used])
            return np.concatenate(parts)

        return lru_cache(maxsize=64)(found)

    def problem(self, own: Sequence[int], weight: Array, bounds: Any) -> Problem:
        """Some effects, from the joints whose weight is not zero."""
        here = weight[self.joint] > 0
        scale = weight[self.joint[here], None]
        ends = np.cumsum([len(self.effects[e].shapes) for e in own])[:-1]

        def columns(shapes: Array) -> Array:
            each = zip(own, np.split(shapes, ends), strict=True)
            parts = [self.columns(e, tuple(x.tolist()))[here] for e, x in each]
            return scale * np.concatenate(parts, axis=1)

        rest, rigid = self.given
        return Problem(
            columns,
            scale[:, 0] * rest[here],
            *bounds,
            free=None if rigid is None else scale * rigid[here],
            block=np.unique(self.block[here], return_inverse=True)[1],
        )

    def rms(self, residual: Array, weight: Array) -> Array:
        """Root mean square of each joint without its weight, shape (n,)."""
        joint = self.joint[weight[self.joint] > 0]
        squares = np.bincount(joint, residual**2, len(weight))
        with np.errstate(invalid="ignore"):
            return np.sqrt(squares / np.bincount(joint, minlength=len(weight))) / weight


def fit_effects(
    effects: Sequence[Effect],
    logs: Sequence[Log],
    *,
    scales: Sequence[Scale],
    cutoff: float = np.inf,
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
        bounds: Bounds by name of a gain or shape, in place of those.
        starts: Points of a Sobol set that are tried as starts, a power of 2.

    Raises:
        IdentificationError: There is nothing to fit, or nothing moves.
    """
    if not effects or not logs:
        raise IdentificationError("one effect and one log or more are needed")
    n, effects = logs[0].rest.shape[1], list(effects)
    rows = _Rows(tuple(effects), logs, cutoff)
    weight = np.zeros(n) if logs[0].rigid is None else np.ones(n)
    alone = [
        (joints, np.isin(np.arange(n), joints).astype(float), starts)
        for joints in _groups(effects, n)
    ]
    for joints, using, tried in (*alone, (range(n), weight, 0)):
        own = [e for e, x in enumerate(effects) if x.reaches(n)[0] in joints]
        some = [effects[e] for e in own]
        limits = _bounds(some, scales, bounds or {})
        start = np.array([x for e in some for x in e.shape_values.values()])
        found = fit_separable(
            rows.problem(own, using, limits), start=start, starts=tried
        )
        rms = rows.rms(found.residual, using)
        known = [j for j in joints if rms[j] > 0]
        weight[known] = 1.0 / rms[known]
        for e, effect in zip(own, _with_values(some, found), strict=True):
            effects[e] = effect
    return EffectFit(tuple(effects), found, rms)


def _groups(effects: Sequence[Effect], size: int) -> list[list[int]]:
    """Joints of an arm of some size that effects couple, in groups."""
    groups: list[set[int]] = []
    for effect in effects:
        joined = set(effect.reaches(size))
        joined = joined.union(*(g for g in groups if g & joined))
        groups = [g for g in groups if not g & joined] + [joined]
    return [sorted(g) for g in groups]


def _names(effects: Sequence[Effect]) -> list[tuple[int, str]]:
    """(effect, parameter) of each shape, then of each gain."""
    shapes = [(e, s.name) for e, effect in enumerate(effects) for s in effect.shapes]
    return shapes + [(e, g.name) for e, x in enumerate(effects) for g in x.gains]


def _with_values(effects: Sequence[Effect], found: Fit) -> list[Effect]:
    """The effects with the values found, and their standard deviations."""
    values = np.concatenate([found.shapes, found.gains]).tolist()
    std = np.where(found.at_bound, np.nan, found.std).tolist()
    rows = [*zip(_names(effects), values, std, strict=True)]
    each = [
        [(name, x, s) for (at, name), x, s in rows if at == e]
        for e in range(len(effects))
    ]
    return [
        effect.at({name: x for name, x, _ in own}, {name: s for name, _, s in own})
        for effect, own in zip(effects, each, strict=True)
    ]


def _bounds(
    effects: Sequence[Effect],
    scales: Sequence[Scale],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[Array, Array]:
    """Lower and upper bounds of all shapes (2, s) and gains (2, p)."""
    shapes = [s.scaled(scales[e.joints[-1]]) for e in effects for s in e.shapes]
    gains = [g for e in effects for g in e.gains]
    ends = [bounds.get(s.name, (s.lower, s.upper)) for s in shapes]
    free = [(0.0 if g.lower >= 0 else -np.inf, np.inf) for g in gains]
    free = [bounds.get(g.name, usual) for g, usual in zip(gains, free, strict=True)]
    return np.reshape(ends, (-1, 2)).T, np.reshape(free, (-1, 2)).T
