"""The candidates: every effect, at every joint, on a grid of its shapes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Self

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.shapes import Range
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import (
    FASTEST,
    Effect,
    Nominal,
    Port,
    Quantity,
    Scale,
    effect_classes,
)
from hybrid.robot import Robot
from hybrid.robot.spatial import link_spread

Place = tuple[str, tuple[int, ...]]  # id of an effect, and its joints

_GRID, _COARSE = 7, 4  # values of the first shape, and of each other one
_GAINS = 14  # of a steep effect
_LEAST_GAIN = 30.0  # typical gain over the smallest one of the scan


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect with given shapes, and the prior of its gains.

    Attributes:
        effect: The effect. Only a ``steep`` one uses the values of its gains.
        std: Prior standard deviation of each gain, shape (p,).
        lower: Lower bound of each gain, shape (p,); −inf without one.
        prior_factor: Factor by which the prior is wider than ``std``.
    """

    effect: Effect
    std: Array
    lower: Array
    prior_factor: float = 1.0

    @property
    def place(self) -> Place:
        """Id of the effect, and its joints."""
        return self.effect.id, self.effect.joints

    def at(self, effect: Effect) -> Self:
        """The candidate with other values, and the bounds that depend on them."""
        own = self.lower == self.effect.least_gains
        lower = np.where(own, effect.least_gains, self.lower)
        return replace(self, effect=effect, lower=lower)

    def fixed_gains(self, gap: Gap) -> Array | None:
        """Gains at which the columns of a steep effect were evaluated, shape (p,).

        Above the visible band its torque is proportional to them, and they are free.
        """
        free = not self.effect.steep or gap.is_above_band(self.effect)
        return None if free else self.effect.gain_values

    def fitted(self, gains: Array) -> Effect:
        """The effect with some gains, or their bounds if they are below these."""
        return with_gains(self.effect, np.maximum(gains, self.lower))


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate with its columns in the evidence.

    Attributes:
        candidate: The effect.
        index: Its columns.
    """

    candidate: Candidate
    index: Index

    @property
    def place(self) -> Place:
        """Id of the effect, and its joints."""
        return self.candidate.place


def candidates(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """Candidates of all effects that change torque, but those ``without``.

    Effects that repeat, such as ripples and contacts, come from a residual; see
    :class:`.Pool`.
    """
    found = []
    for cls in effect_classes().values():
        other = cls.port is Port.COMMAND or cls.composite or cls.repeats
        if other or cls.id in without:
            continue
        for joints in cls.places(gap.robot.size):
            found += [candidate(gap, e) for e in _grid(cls, joints, gap)]
    return found


def repeating(where: str, without: Sequence[str] = ()) -> list[type[Effect]]:
    """Effects that may occur several times; see :attr:`.Effect.repeats`."""
    every = effect_classes().values()
    return [x for x in every if x.repeats == where and x.id not in without]


def usual(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """Candidates of the effects that most joints have; see :attr:`.Effect.usual`."""
    kinds = [x for x in effect_classes().values() if x.usual and x.id not in without]
    return [candidate(gap, x((j,))) for x in kinds for j in range(gap.robot.size)]


def candidate(gap: Gap, effect: Effect) -> Candidate:
    """An effect with the prior of its gains."""
    return Candidate(effect, *effect.prior(nominal(gap.robot), scale_of(gap, effect)))


def gain_grid(gain: Quantity) -> Array:
    """Gains at which a steep effect is tried, in equal ratios and its unit, (g,)."""
    return np.geomspace(gain.typical / _LEAST_GAIN, gain.upper, _GAINS)


def _grid(cls: type[Effect], joints: tuple[int, ...], gap: Gap) -> Iterator[Effect]:
    scale = gap.scales[joints[-1]]
    shapes = [s.scaled(scale) for s in cls.shapes]
    fastest = max(float(np.abs(m.v[:, joints[-1]]).max()) for m in gap.motions)
    shown = [s.name for s in cls.shapes_along(gap.motions)]
    axes = [
        np.clip([fastest], s.lower, s.upper) if s.name == FASTEST.name
        else np.array([s.typical]) if s.name not in shown
        else _axis(s, _COARSE if shown.index(s.name) else _GRID)
        for s in shapes
    ]  # fmt: skip
    if cls.steep:
        # Its shapes stay at typical values here, and are fitted on the shortlist.
        (gain,) = (g.scaled(scale) for g in cls.gains)
        axes = [np.array([s.typical]) for s in shapes]
        axes.append(gain_grid(gain))
        shapes.append(gain)
    names = [s.name for s in shapes]
    tried = [
        cls(joints, dict(zip(names, map(float, x), strict=True)))
        for x in product(*axes)
    ]
    above = [cls.steep and gap.is_above_band(x) for x in tried]
    yield from tried[max(sum(above) - 1, 0) :]  # those above the band are alike
    if more := cls.suggested(gap.motions, joints[-1]):
        named = {s.name: float(np.clip(more[s.name], s.lower, s.upper)) for s in shapes}
        yield cls(joints, named)


def _axis(shape: Quantity, count: int) -> Array:
    """Values of a shape within its range."""
    known = Range(shape)
    if shape.whole and not known.logarithmic:
        return np.arange(shape.lower, shape.upper + 1.0)
    return np.array([known.value(x) for x in np.linspace(0.0, 1.0, count + 2)[1:-1]])


def nominal(robot: Robot) -> Nominal:
    """Numbers of a robot file."""
    inertial, own = robot.chain.inertial, robot.chain.armature
    size = link_spread(inertial)
    return Nominal(inertial, size, own, robot.damping, robot.frictionloss)


def scale_of(gap: Gap, effect: Effect) -> Scale:
    """Scale of the joint to which an effect's parameters refer."""
    return gap.scales[effect.joints[-1]]


def with_gains(effect: Effect, gains: Sequence[float] | Array) -> Effect:
    """An effect with given gains, shape (p,); a steep one keeps its own."""
    if effect.steep:
        return effect
    names = [g.name for g in effect.gains]
    return effect.at(dict(zip(names, map(float, gains), strict=True)))


def delivered(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects fitted to reported torque, with the gains of the delivered torque.

    A drive that reports a part of its torque reports that part of its friction. What
    acts at several joints is left as it is.
    """
    scale = dict[int, float]()
    for e in effects:
        for j in e.joints if e.reports else ():
            scale[j] = scale.get(j, 1.0) * e.torque_scale
    found = []
    for e in effects:
        own = scale.get(e.joints[0], 1.0)
        if own != 1.0 and len(e.joints) == 1 and not (e.reports or e.observes):
            names = {g.name for g in e.gains}
            values, std = (
                {x: y / own if x in names else y for x, y in known.items()}
                for known in (e.values, e.std)
            )
            e = e.at(values, std)
        found.append(e)
    return tuple(found)


def same_columns(a: Columns, b: Columns) -> bool:
    """Whether columns are equal, at the same joints."""
    return a.keys() == b.keys() and all(np.array_equal(a[j], b[j]) for j in a)
