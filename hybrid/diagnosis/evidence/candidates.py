"""Every effect that might be the cause, at every joint, on a grid of its shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import Effect, effect_classes
from hybrid.effects.effect import Port, Quantity, Scale
from hybrid.effects.nominal import Nominal
from hybrid.robot import Robot
from hybrid.robot.spatial import link_spread

Place = tuple[str, tuple[int, ...]]  # id of an effect, and its joints

_GRID = 7
_COARSE = 4
_GAINS, _FINE = 14, 40  # of an effect that is scanned over its gain
_EFFORT = 8e5  # samples times gains; of long logs fewer are tried
_LEAST_GAIN = 30.0  # its usual gain over the least that is tried


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect with unit gains that may be tried.

    Attributes:
        effect: The effect; its shapes count, its gains do not.
        std: Prior standard deviation of each gain, shape (p,).
        lower: Smallest physical gain, shape (p,); −inf without one.
        wider: How many times wider than usual the prior is.
    """

    effect: Effect
    std: Array
    lower: Array
    wider: float = 1.0

    @property
    def place(self) -> Place:
        """Which effect, and where."""
        return self.effect.id, self.effect.joints

    @property
    def made_at(self) -> Array | None:
        """Its gains, where its columns are of these alone, shape (p,)."""
        return self.effect.gain_values if self.effect.steep else None


def candidates(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """All effects that leave a trace in torque, but ripples; see :mod:`.ripples`.

    Args:
        gap: The gap.
        without: Ids of effects to leave out of the library.
    """
    found = []
    for cls in effect_classes().values():
        own = cls.port is Port.COMMAND or cls.composite or cls.repeats
        if own or cls.id in without:
            continue
        for joints in cls.places(gap.robot.size):
            found += [candidate(gap, e) for e in _grid(cls, joints, gap)]
    return found


def usual(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """What most joints have, at every joint; see :attr:`.Effect.usual`."""
    kinds = [x for x in effect_classes().values() if x.usual and x.id not in without]
    return [candidate(gap, x((j,))) for x in kinds for j in range(gap.robot.size)]


def candidate(gap: Gap, effect: Effect) -> Candidate:
    """An effect with the priors of its gains."""
    return Candidate(effect, *effect.prior(nominal(gap.robot), scale_of(gap, effect)))


def fine_candidates(
    gap: Gap, cls: type[Effect], joints: tuple[int, ...]
) -> list[Candidate]:
    """A steep effect at one place, on a grid of gains that misses no peak.

    The link behind a play lands at other times with each width.
    """
    samples = sum(len(motion.t) for motion in gap.motions)
    count = int(np.clip(_EFFORT / samples, _FINE / 2, _FINE))
    return [candidate(gap, e) for e in _grid(cls, joints, gap, gains=count)]


def _grid(
    cls: type[Effect], joints: tuple[int, ...], gap: Gap, *, gains: int = _GAINS
) -> Iterator[Effect]:
    scale = gap.scales[joints[-1]]
    shapes = [s.scaled(scale) for s in cls.shapes]
    axes = [grid(s, _COARSE if k else _GRID) for k, s in enumerate(shapes)]
    if cls.steep:
        # Its shapes are fitted once it is on the shortlist.
        (gain,) = (g.scaled(scale) for g in cls.gains)
        axes = [np.array([s.typical]) for s in shapes]
        axes += [np.geomspace(gain.typical / _LEAST_GAIN, gain.upper, gains)]
        shapes.append(gain)
    for values in product(*axes):
        named = {s.name: float(x) for s, x in zip(shapes, values, strict=True)}
        yield cls(joints, named)
    if more := cls.suggested(gap.motions, joints[-1]):
        named = {s.name: float(np.clip(more[s.name], s.lower, s.upper)) for s in shapes}
        yield cls(joints, named)


def grid(shape: Quantity, count: int) -> Array:
    """Values between a shape's bounds, even in their logarithm if that is wide."""
    if shape.lower > 0 and shape.upper > 8 * shape.lower:
        edges = np.geomspace(shape.lower, shape.upper, count + 2)
        return edges[1:-1]
    if shape.whole:
        return np.arange(shape.lower, shape.upper + 1.0)
    edges = np.linspace(shape.lower, shape.upper, count + 2)
    return edges[1:-1]


def declared(robot: Robot) -> dict[str, Array]:
    """Numbers of a robot file that an effect is a change of, shape (n,) each."""
    file = nominal(robot)
    known = {x.id: x.declared(file) for x in effect_classes().values()}
    return {name: x for name, x in known.items() if x is not None}


def nominal(robot: Robot) -> Nominal:
    """Numbers of a robot file."""
    inertial, own = robot.chain.inertial, robot.chain.armature
    size = link_spread(inertial)
    return Nominal(inertial, size, own, robot.damping, robot.frictionloss)


def scale_of(gap: Gap, effect: Effect) -> Scale:
    """Size of the joint by which an effect's parameters are measured."""
    return gap.scales[effect.joints[-1]]


def with_gains(effect: Effect, gains: Sequence[float] | Array) -> Effect:
    """An effect with its gains in order, shape (p,); a steep one has them already."""
    if effect.steep:
        return effect
    names = [g.name for g in effect.gains]
    return effect.at(dict(zip(names, map(float, gains), strict=True)))


def same(a: Columns, b: Columns) -> bool:
    """Whether columns are the same at the same joints."""
    return (
        a.keys() == b.keys()
        and all(a[j].shape == b[j].shape for j in a)
        and all(np.array_equal(a[j], b[j]) for j in a)
    )
