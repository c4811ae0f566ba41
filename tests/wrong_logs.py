"""Logs that are not what their columns say, made of logs that are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.plant import Plant, random_fourier
from hybrid.recording import Recording
from hybrid.robot import Robot

GLITCHES = 5
HELD = 10


@dataclass(frozen=True)
class Wrong:
    """One way to write a log wrongly.

    Attributes:
        make: Log, joint and another joint -> the wrong log.
        channels: Where a doubt may see it; any of them is the right place.
        words: What the doubt must say, any of them.
        about: Which columns: ``one`` joint, a ``pair``, or ``all``.
        joints: Joints that an arm has at least, for this to be possible.
        small: Whether it is made of a log of small motion.
    """

    make: Callable[[Recording, int, int], Recording]
    channels: tuple[str, ...]
    words: tuple[str, ...]
    about: str = "all"
    joints: int = 1
    small: bool = False


def changed(x: Recording, change: Callable, *names: str) -> Recording:
    """A log with some channels, where it has them, changed alike."""
    has = {n: change(v) for n, v in x.channels.items() if n in names}
    return replace(x, **has)


MOTION = ("q", "v", "command")
EVERY = (*MOTION, "tau")


def ordered(order: Callable[[Recording, int, int], Sequence[int]], *names: str):
    """Columns in another order."""
    return lambda x, i, j: changed(x, lambda c: c[:, list(order(x, i, j))], *names)


def scaled(size: float, *names: str, one: bool = False, spread: float = 0.0):
    """Columns times a number; of one joint, or of all, of each by its own."""

    def make(x: Recording, i: int, j: int) -> Recording:
        factor = size * np.linspace(1 - spread, 1 + spread, x.size)
        if one:
            factor = np.where(np.arange(x.size) == i, size, 1.0)
        return changed(x, lambda c: c * factor, *names)

    return make


def swapped(x: Recording, i: int, j: int) -> list[int]:
    order = list(range(x.size))
    order[i], order[j] = j, i
    return order


def reverse(x: Recording, i: int, j: int) -> list[int]:
    return list(range(x.size))[::-1]


def by_name(x: Recording, i: int, j: int) -> list[int]:
    return [x.joints.index(name) for name in sorted(x.joints)]


def turned(x: Recording, i: int, j: int) -> list[int]:
    return list(np.roll(range(x.size), 1))


def slower(factor: float, speed: bool):
    def make(x: Recording, i: int, j: int) -> Recording:
        return replace(x, t=x.t * factor, v=x.v if speed else None)

    return make


def magnitude(x: Recording, i: int, j: int) -> Recording:
    return replace(x, tau=np.abs(x.tau))


def glitch(x: Recording, i: int, j: int) -> Recording:
    q = x.q.copy()
    rows = np.linspace(0, len(q) - 1, GLITCHES + 2).astype(int)[1:-1]
    q[rows, i] += 0.5
    return replace(x, q=q)


def held(x: Recording, i: int, j: int) -> Recording:
    rows = np.arange(len(x.t)) // HELD * HELD
    return changed(x, lambda c: c[rows], *EVERY)


def repeated(x: Recording, i: int, j: int) -> Recording:
    step = float(np.median(np.diff(x.t)))
    twice = changed(x, lambda c: c, *EVERY)
    fields = {n: np.vstack([v, v]) for n, v in twice.channels.items()}
    return replace(x, t=x.t[0] + step * np.arange(2 * len(x.t)), **fields)


def joined(x: Recording, i: int, j: int) -> Recording:
    """Two parts of a log with nothing between them, and no gap in time."""
    n = len(x.t)
    rows = np.r_[0 : n // 3, n // 2 : n]
    fields = {name: v[rows] for name, v in x.channels.items()}
    return replace(x, t=x.t[: len(rows)], **fields)


def uncounted(x: Recording, i: int, j: int) -> Recording:
    q = x.q.copy()
    q[len(q) // 2 :, i] -= 2 * np.pi
    return replace(x, q=q)


def still(x: Recording, i: int, j: int) -> Recording:
    """Only one joint's position is logged as moving."""
    keep = np.arange(x.size) == i
    return changed(x, lambda c: np.where(keep, c, c[:1]), "q", "command")


DEGREES = 180 / np.pi
WRONG: dict[str, Wrong] = {
    "torques swapped": Wrong(
        ordered(swapped, "tau"), ("tau",), ("swapped",), "pair"),
    "positions swapped": Wrong(
        ordered(swapped, *MOTION), ("q",), ("swapped",), "pair"),
    "joints swapped": Wrong(
        ordered(swapped, *EVERY), ("q",), ("swapped",), "pair"),
    "torques reversed": Wrong(
        ordered(reverse, "tau"), ("tau",), ("reverse",), joints=3),
    "torques by name": Wrong(
        ordered(by_name, "tau"), ("tau",), ("by name", "in the order", "swapped"),
        joints=3),
    "torques turned": Wrong(
        ordered(turned, "tau"), ("tau",), ("in the order",), joints=3),
    "positions reversed": Wrong(
        ordered(reverse, *MOTION), ("q",), ("reverse", "in the order"), joints=3),
    "joints reversed": Wrong(
        ordered(reverse, *EVERY), ("q",), ("reverse", "in the order"), joints=3),
    "sign of a torque": Wrong(
        scaled(-1, "tau", one=True), ("tau",), ("other way",), "one"),
    "sign of all torques": Wrong(scaled(-1, "tau"), ("tau",), ("other way",)),
    "sign of a position": Wrong(
        scaled(-1, *MOTION, one=True), ("q",), ("other way",), "one"),
    "sign of a joint": Wrong(
        scaled(-1, *EVERY, one=True), ("q",), ("other way",), "one"),
    "magnitude of torque": Wrong(magnitude, ("tau",), ("magnitude",)),
    "torque in kN·m": Wrong(scaled(1e-3, "tau"), ("tau",), ("kN·m",)),
    "torque in mN·m": Wrong(scaled(1e3, "tau"), ("tau",), ("mN·m", "milliamps")),
    "motor side, one gear": Wrong(scaled(0.01, "tau"), ("tau",), ("motor side",)),
    "motor side, gears": Wrong(
        scaled(0.01, "tau", spread=0.4), ("tau",), ("motor side",)),
    "motor side of a joint": Wrong(
        scaled(0.01, "tau", one=True), ("tau",), ("motor side",), "one"),
    "degrees": Wrong(scaled(DEGREES, *MOTION), ("q",), ("degrees",)),
    "small degrees": Wrong(
        scaled(DEGREES, *MOTION), ("q",), ("degrees",), small=True),
    "degrees of a joint": Wrong(
        scaled(DEGREES, *MOTION, one=True), ("q",), ("degrees",), "one"),
    "milliradians": Wrong(
        scaled(1e3, *MOTION), ("q",), ("milliradians", "far outside")),
    "milliseconds": Wrong(slower(1e3, True), ("t",), ("millisec",)),
    "microseconds": Wrong(slower(1e6, False), ("t",), ("microsec",)),
    "nanoseconds": Wrong(slower(1e9, False), ("t",), ("nanosec",)),
    "twice the time": Wrong(slower(2, True), ("t",), ("clock", "scaled by")),
    "twice the time, no speed": Wrong(
        slower(2, False), ("t", "tau"), ("scaled by", "clock")),
    "half the time, no speed": Wrong(
        slower(0.5, False), ("t", "tau"), ("scaled by", "clock")),
    "glitches": Wrong(glitch, ("q",), ("glitch",), "one"),
    "held samples": Wrong(held, ("q",), ("holds each sample for 10",)),
    "repeated with a jump": Wrong(repeated, ("q",), ("repeats its first rows",)),
    "put together": Wrong(joined, ("q",), ("jumps",)),
    "turn not counted": Wrong(uncounted, ("q",), ("turn of the encoder",), "one"),
    "one joint moves": Wrong(still, ("q", "v"), ("only", "constant"), joints=3),
    "speed twice": Wrong(scaled(2, "v", one=True), ("v",), ("2 times",), "one"),
    "speed in degrees": Wrong(scaled(DEGREES, "v"), ("v",), ("degrees per",)),
    "speed turned round": Wrong(
        scaled(-1, "v", one=True), ("v",), ("other way",), "one"),
    "speeds swapped": Wrong(ordered(swapped, "v"), ("v",), ("looks like",), "pair"),
}  # fmt: skip


def about(wrong: Wrong, i: int, j: int) -> set[int]:
    """Columns that a doubt must name, any of them; none if it is about all."""
    return {"one": {i}, "pair": {i, j}, "all": set()}[wrong.about]


def healthy(
    robot: Robot,
    *,
    nominal: Robot | None = None,
    effects: Sequence = (),
    seed: int = 0,
    fill: float = 0.7,
    reach: float | None = None,
    rest: int | None = None,
    count: float = 0.0,
    duration: float = 10.0,
) -> Recording:
    """A log of an arm as it is written.

    Args:
        robot: The arm as it is.
        nominal: As its file is; the same by default.
        effects: What it has besides.
        seed: Seed of motion and noise.
        fill: Part of its limits that the motion uses.
        reach: Range of every joint about zero instead, [rad].
        rest: A joint that is held still.
        count: Noise of positions beyond the usual, [rad].
        duration: Length, [s].
    """
    rng = np.random.default_rng(seed)
    believed = nominal or robot
    r = random_fourier(believed, duration=duration, rate=500.0, seed=rng, fill=fill)
    if reach is not None:
        share = reach / np.maximum(np.ptp(r.q, axis=0), reach)
        r = replace(r, q=(r.q - r.q.mean(0)) * share, v=r.v * share, a=r.a * share)
    if rest is not None:
        moves = np.arange(robot.size) != rest
        r = replace(r, q=np.where(moves, r.q, r.q[0]), v=r.v * moves, a=r.a * moves)
    plant = Plant(robot, effects, nominal=believed, step=0.001)
    (x,) = plant.run([r], seed=rng)
    return replace(x, q=x.q + count * rng.standard_normal(x.q.shape))
