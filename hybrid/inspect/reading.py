"""List other readings of a log: other order, signs, units, zeros or clock."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.inspect.state import State
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

_ROUND = "to count the other way round"
_DEGREE = np.pi / 180
_UNITS = {
    1e3: "to be in kN·m, or too small by as much",
    1e2: "to be of the motor side of a gear, or too small by as much",
    1e-3: "to be in mN·m, or too large by as much",
}
_TURNS = {0.25: "a quarter turn", -0.25: "a quarter turn", 0.5: "half a turn"}
_CLOCKS = {
    1e-3: "in milliseconds",
    1e-6: "in microseconds",
    1e-9: "in nanoseconds",
    0.1: "scaled by 10",
    0.25: "scaled by 4",
    0.5: "scaled by 2",
    2.0: "scaled by 1/2",
    4.0: "scaled by 1/4",
    10.0: "scaled by 1/10",
}


@dataclass(frozen=True, eq=False)
class OtherReading:
    """One way to read a log.

    Attributes:
        channels: Channels that are read differently: ``q``, ``tau``, both, or ``t``.
        joints: Columns that are read differently, counted from 0.
        looks_like: Fault of these columns if this reading is right.
        order: Column of each joint, shape (n,).
        factor: Factor of each column, shape (n,).
        clock: True time over logged time.
        shift: What is added to each position, shape (n,), [rad or m].
        lag: Time by which torques come after positions, [s].
    """

    channels: tuple[str, ...]
    joints: tuple[int, ...]
    looks_like: str
    order: Index
    factor: Array
    clock: float = 1.0
    shift: Array | float = 0.0
    lag: float = 0.0

    @property
    def motion(self) -> tuple[bytes, bytes, bytes, float, float]:
        """A key, equal for readings with the same motion."""
        if "q" in self.channels:
            shift = np.asarray(self.shift).tobytes()
            columns = self.order.tobytes(), self.factor.tobytes()
            return *columns, shift, self.clock, self.lag
        return b"", b"", b"", self.clock, self.lag

    @property
    def torque(self) -> tuple[Index, Array]:
        """Torque column of each joint, and its factor, (n,) each."""
        if "tau" in self.channels:
            return self.order, self.factor
        return np.arange(len(self.order)), np.ones(len(self.order))

    def moved(self, state: State) -> State:
        """The log with its motion by this reading, and its torque at those times."""
        q, v, a = state.q, state.v / self.clock, state.a / self.clock**2
        if "q" in self.channels:
            q, v, a = (self.factor * x[:, self.order] for x in (q, v, a))
        tau = state.later[self.lag] if self.lag else state.tau
        return replace(state, q=q + self.shift, v=v, a=a, tau=tau)

    def of(self, state: State) -> State:
        """The log with motion and torque by this reading."""
        order, factor = self.torque
        moved = self.moved(state)
        return replace(moved, tau=factor * moved.tau[:, order], later={})


def readings(
    robot: Robot, moving: list[int], best: Index, lags: Iterable[float]
) -> Iterator[OtherReading]:
    """List orders, signs, units and clocks that a log may have, simple ones first.

    Args:
        robot: The arm.
        moving: Joints that move; only their positions can be tested.
        best: Torque column that fits each joint best, shape (n,).
        lags: Times by which torques may come after positions, [s].
    """
    n, chain = robot.size, robot.chain
    kept, ones = np.arange(n), np.ones(n)
    for channels in (("tau",), ("q",), ("q", "tau")):
        of_torque = channels == ("tau",)
        among = list(range(n)) if of_torque else moving
        for j in among:
            turned = np.where(kept == j, -1.0, 1.0)
            yield OtherReading(channels, (j,), _ROUND, kept, turned)
        for pair in combinations(among, 2):
            order = kept.copy()
            order[list(pair)] = order[list(pair[::-1])]
            yield OtherReading(channels, pair, "swapped", order, ones)
        for words, order in _orders(chain, best if of_torque else kept):
            joints = tuple(np.flatnonzero(order != kept).tolist())
            if len(joints) > 2 and set(joints) <= set(among):
                yield OtherReading(channels, joints, words, order, ones)
    if n > 1:
        yield OtherReading(("tau",), tuple(range(n)), _ROUND, kept, -ones)
        if np.isfinite(share := robot.tau_max / 100).all() and share.all():
            words = "to be in percent of the rating"
            yield OtherReading(("tau",), tuple(range(n)), words, kept, share)
        for factor, words in _UNITS.items():
            for j in moving:
                each = np.where(kept == j, factor, 1.0)
                yield OtherReading(("tau",), (j,), words, kept, each)
    turning = tuple(j for j in moving if chain.revolute[j])
    for joints in dict.fromkeys([turning, *((j,) for j in turning)]):
        each = np.where(np.isin(kept, joints), _DEGREE, 1.0)
        yield OtherReading(("q",), joints, "to be in degrees", kept, each)
    for j in turning:
        for turn, name in _TURNS.items():
            words = f"to count from a zero {name} off"
            shift = np.where(kept == j, turn * 2 * np.pi, 0.0)
            yield OtherReading(("q",), (j,), words, kept, ones, shift=shift)
    for lag in lags:
        words = f"to be some {abs(lag):g} s {'late' if lag > 0 else 'early'}"
        yield OtherReading(("tau",), tuple(range(n)), words, kept, ones, lag=lag)
    for clock, words in _CLOCKS.items():
        yield OtherReading(("t",), (), words, kept, ones, clock)


def _orders(chain: Chain, best: Index) -> list[tuple[str, Index]]:
    """Common orders of columns and the best order, each once, with its name."""
    place = np.argsort(np.argsort(chain.joints))
    names = ", ".join(chain.joints[k] for k in np.argsort(best))
    orders = {
        "to be in reverse order": np.arange(chain.size)[::-1].copy(),
        "to be sorted by name": place,
        f"to be in the order {names}": best,
    }
    once: dict[bytes, tuple[str, Index]] = {}
    for words, order in orders.items():
        once.setdefault(order.tobytes(), (words, order))
    return list(once.values())
