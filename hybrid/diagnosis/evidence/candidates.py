"""Every effect that might be the cause, at every joint, on a grid of its shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.background import link_spread
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import Effect, effect_classes
from hybrid.effects.effect import Port, Quantity, Scale
from hybrid.effects.payload import LinkInertia, Payload
from hybrid.effects.torque_gain import TorqueGain
from hybrid.robot import Robot

Place = tuple[str, tuple[int, ...]]  # id of an effect, and its joints

# Laws that sum up others, for fitting.
_COMPOSITE = {"threshold_friction", "improved_stribeck"}
_SEARCHED = {"torque_ripple", "contact"}  # their shapes come from the residual
_GRID = 7
_COARSE = 4
_GAINS, _FINE = 14, 40  # of an effect that is scanned over its gain
_EFFORT = 8e5  # samples times gains; of long logs fewer are tried
_LEAST_GAIN = 30.0  # its usual gain over the least that is tried
# Laws that another becomes at a bound of its shapes.
_SIMPLER = {
    "presliding": "coulomb",
    "thermal_friction": "viscous",
    "counterbalance": "spring",
}
# Laws that say by how much friction differs from another, which they come on top of.
_UPON = {"stribeck": "coulomb", "nonlinear_viscous": "viscous"}
# Laws that an arm may have in place of the one that its file declares.
_INSTEAD = {"presliding": "coulomb", "thermal_friction": "viscous"}
HARDLY = 1e-3  # of a law's evidence: none holds more exactly
_EARLY = {"delay": "actuator_lag", "actuator_lag": "delay"}  # if time is negative
_EARLY_SLACK = 0.08  # of the evidence: noise of positions costs a lag that much
_MERE = 0.05  # of a number of the file
_PROMPT = 1e-3  # s: what a controller of 500 Hz is late by, as it holds its torque
_LINK_OFF = 0.15  # a link that is wrong is so by this much
_LINK_MOST = 1.0  # and hardly ever by more than all that it is

# Of the mass of a middling link: what an arm usually carries, within a hand's breadth.
_PAYLOAD = (1.0, *[0.1] * 3, *[0.02] * 6)


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

    def likely(self, gains: Array) -> bool:
        """Whether some gains leave a link one that the file might have meant."""
        most = _LINK_MOST / _LINK_OFF * self.std
        return self.effect.id != LinkInertia.id or bool(np.all(np.abs(gains) < most))


def candidates(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """All effects that leave a trace in torque, but ripples; see :mod:`.ripples`.

    Args:
        gap: The gap.
        without: Ids of effects to leave out of the library.
    """
    found = []
    for cls in effect_classes().values():
        if cls.port is Port.COMMAND or cls.id in _COMPOSITE | _SEARCHED | {*without}:
            continue
        for joints in places(cls, gap.robot.size):
            found += [candidate(gap, e) for e in _grid(cls, joints, gap)]
    return found


def usual(gap: Gap, without: Sequence[str] = ()) -> list[Candidate]:
    """What most joints have, at every joint; see :attr:`.Effect.usual`."""
    kinds = [x for x in effect_classes().values() if x.usual and x.id not in without]
    return [candidate(gap, x((j,))) for x in kinds for j in range(gap.robot.size)]


def candidate(gap: Gap, effect: Effect) -> Candidate:
    """An effect with the priors of its gains."""
    scale = gap.scales[effect.joints[-1]]
    gains = [g.scaled(scale) for g in effect.gains]
    std = np.array([_spread(g) for g in gains])
    lower = effect.least_gains
    if effect.id in (known := declared(gap.robot)):
        lower = -known[effect.id][list(effect.joints)]  # the file may say too much
    if effect.id == Payload.id:
        std = np.array(_PAYLOAD) * max(np.median(gap.robot.chain.inertial[:, 0]), 0.1)
    if effect.id == LinkInertia.id:
        std = _LINK_OFF * link_spread(gap.robot.chain.inertial)[effect.joints[-1]]
        lower = np.full(len(std), -np.inf)
    return Candidate(effect, std, lower)


def fine_candidates(
    gap: Gap, cls: type[Effect], joints: tuple[int, ...]
) -> list[Candidate]:
    """A steep effect at one place, on a grid of gains that misses no peak.

    The link behind a play lands at other times with each width.
    """
    samples = sum(len(motion.t) for motion in gap.motions)
    count = int(np.clip(_EFFORT / samples, _FINE / 2, _FINE))
    return [candidate(gap, e) for e in _grid(cls, joints, gap, gains=count)]


def _spread(gain: Quantity) -> float:
    """Prior standard deviation: twice the usual size, or a third of the largest."""
    if gain.spread is not None:
        return gain.spread
    largest = max(abs(gain.lower), abs(gain.upper)) / 3
    return min(2 * abs(gain.typical), largest) if gain.typical else largest


def places(cls: type[Effect], size: int) -> Iterator[tuple[int, ...]]:
    """Where an effect may sit on an arm of some joints."""
    if cls.scope == "joint":
        yield from ((j,) for j in range(size))
    elif cls.scope == "arm":
        yield tuple(range(size))
    elif cls.id == LinkInertia.id:
        yield from (tuple(range(k + 1)) for k in range(size))
    else:
        yield from ((j, j + 1) for j in range(size - 1))


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
    return {
        "viscous": robot.damping,
        "coulomb": robot.frictionloss,
        "armature": robot.chain.armature,
    }


def undeclared(robot: Robot, effect: Effect) -> bool:
    """Whether an effect is a number that every drive has, and the file lacks."""
    known = declared(robot).get(effect.id)
    return known is not None and not known[list(effect.joints)].any()


def mere(robot: Robot, effect: Effect) -> bool:
    """Whether an effect changes a number of the file by as little as it is off anyway.

    Args:
        robot: The file.
        effect: The effect with its gains.
    """
    known = declared(robot).get(effect.id)
    if effect.id == TorqueGain.id:  # of all numbers outward
        known = np.ones(robot.size)
    if known is None:
        return False
    return bool(abs(effect.gain_values[0]) < _MERE * known[effect.joints[0]])


def prompt(effect: Effect) -> bool:
    """Whether all that an effect is late by is what any sampled drive is."""
    return effect.id in _EARLY and abs(effect.values["time"]) < _PROMPT


def scale_of(gap: Gap, effect: Effect) -> Scale:
    """Size of the joint by which an effect's parameters are measured."""
    return gap.scales[effect.joints[-1]]


def with_gains(effect: Effect, gains: Sequence[float] | Array) -> Effect:
    """An effect with its gains in order, shape (p,); a steep one has them already."""
    if effect.steep:
        return effect
    names = [g.name for g in effect.gains]
    return effect.at(dict(zip(names, map(float, gains), strict=True)))


def simpler(effect: Effect) -> tuple[str, float]:
    """Which effect to name rather than this one, if it explains nearly as much.

    A drive lags, so that the torque it is asked for leads; a log comes late.

    Returns:
        Its id, and the part of the evidence that it may explain less.
    """
    if effect.id in _EARLY and effect.values["time"] < 0:
        return _EARLY[effect.id], _EARLY_SLACK
    return _SIMPLER.get(effect.id, ""), HARDLY


def plainer(effect: Effect) -> str:
    """Id of a plainer law of the same kind, or nothing."""
    return _UPON.get(effect.id) or _SIMPLER.get(effect.id, "")


def fuller(effect: Effect) -> str:
    """Id of the law that becomes an effect's at a bound of its shapes, or nothing."""
    return next((f for f, s in _SIMPLER.items() if s == effect.id), "")


def instead(effect: Effect) -> str:
    """Id of the declared law whose place an effect may take, or nothing."""
    return _INSTEAD.get(effect.id, "")


def same(a: Columns, b: Columns) -> bool:
    """Whether columns are the same at the same joints."""
    return (
        a.keys() == b.keys()
        and all(a[j].shape == b[j].shape for j in a)
        and all(np.array_equal(a[j], b[j]) for j in a)
    )
