"""Accept or reject the samples of a stream, and group them into blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.online.health import Health
from hybrid.signals.streaming import STRETCH

_FATES = ("used", "not_finite", "implausible", "repeated", "late", "jumped")

_BELIEVED = 10  # samples that follow each other, before a new clock is believed
_CLOSEST = 0.1  # period between two samples, else the second repeats the first
_LARGEST, _LATEST = 1e6, 1e15  # in SI units: of what an arm does, and of a stamp
_MEMORY = 1.0  # s, of the share that is lost
_GAIN, _STEP = 0.05, 0.1  # of the period's mean: share of news, and at most of itself


@dataclass(frozen=True)
class Sample:
    """What a controller knows at one instant.

    Attributes:
        t: Time, [s].
        q: Joint position, shape (n,), [rad].
        tau: Drive torque, shape (n,), [N·m].
        v: Joint speed, shape (n,), [rad/s]; with ``a``, or None to differentiate q.
        a: Joint acceleration, shape (n,), [rad/s²], or None.
    """

    t: float
    q: Array
    tau: Array
    v: Array | None = None
    a: Array | None = None


class Intake:
    """Accepts samples that follow each other, and groups them into blocks.

    One rule holds for clock and position: a sample is taken in if it follows the last
    one within reach of the window, no faster than ``speed``. One that does not is left
    out, until some in a row follow each other: then the stream goes on from there, and
    its own clock leaves a gap that no window bridges.

    Args:
        size: Joints n.
        rate: Samples per second, [Hz].
        window: Time over which samples are differentiated, [s]; 0 if they bring speed
            and acceleration.
        speed: Speed of all joints together beyond which a position is wrong, [rad/s].
        torque: Torque of all joints together beyond which it is wrong, [N·m].
        before: Samples of the past that a block brings along.
        block: New samples in a block.
    """

    def __init__(
        self,
        size: int,
        *,
        rate: float,
        window: float,
        speed: float,
        torque: float,
        before: int,
        block: int,
    ) -> None:
        self._n, self._rate, self._brings = size, rate, 2 if window else 4
        self._reach = (STRETCH - 1.0) * window if window else math.inf
        self._gap = max(STRETCH * window, 1.0 / rate)
        self._speed, self._torque = speed if window else math.inf, torque
        self._rows = np.zeros((before + block, 1 + self._brings * size))
        self._before, self._filled, self._clock = before, 0, 0.0
        self._last: Array | None = None
        self._rival: Array | None = None
        self._followers = self._between = 0
        self._stamp, self._period = math.nan, 1.0 / rate
        self._lost, self._news = 0.0, 1.0 / (1.0 + rate * _MEMORY)
        self._count = dict.fromkeys((*_FATES, "missing", "restarts"), 0)

    @property
    def now(self) -> float:
        """Time stamp of the last accepted sample, [s]."""
        return math.nan if self._last is None else float(self._last[0])

    @property
    def health(self) -> Health:
        """What became of the samples so far."""
        return Health(
            received=sum(self._count[fate] for fate in _FATES),
            **self._count,
            lost=self._lost,
            rate=1.0 / self._period,
            stated_rate=self._rate,
        )

    def take(self, sample: Sample) -> Array | None:
        """Take a sample in, or leave it out.

        Returns:
            When a block is full, its rows with those before: the stream's own time,
            [s], then position and torque, and speed and acceleration where samples
            bring them. None else.
        """
        row = self._row(sample)
        fate = self._fate(row)
        self._count[fate] += 1
        self._lost += (float(fate != "used") - self._lost) * self._news
        if fate != "used":
            self._between += fate not in ("late", "repeated")
            return None
        self._go_on(row)
        rows = self._rows
        rows[self._filled] = row
        rows[self._filled, 0] = self._clock
        self._filled += 1
        if self._filled < len(rows):
            return None
        block = rows.copy()
        rows[: self._before] = block[len(rows) - self._before :]
        self._filled = self._before
        return block

    def _row(self, sample: Sample) -> Array:
        parts: list[ArrayLike] = [[sample.t], sample.q, sample.tau]
        if self._brings == 4:
            if sample.v is None or sample.a is None:
                raise IdentificationError(
                    "a sample brings no speed and acceleration; without a cut-off, or "
                    "where the first one brings them, every sample must"
                )
            parts += [sample.v, sample.a]
        try:
            row = np.concatenate(parts, dtype=float)
        except (TypeError, ValueError) as error:
            raise IdentificationError(f"a sample is not of numbers: {error}") from error
        if row.size != self._rows.shape[1]:
            raise IdentificationError(
                f"a sample has {row.size - 1} numbers beside its time; valid are "
                f"{self._n} of each kind, {self._rows.shape[1] - 1} in all"
            )
        return row

    def _fate(self, row: Array) -> str:
        """What becomes of a sample."""
        stamp, largest = float(row[0]), float(np.abs(row[1:]).max())
        if not (math.isfinite(stamp) and math.isfinite(largest)):
            return "not_finite"
        if largest > _LARGEST or abs(stamp) > _LATEST or not self._is_torque(row):
            return "implausible"
        self._measure_rate(stamp)
        if self._last is None:
            return "used"
        fate = self._follows(self._last, row)
        if fate in ("used", "repeated"):
            return fate
        if self._rival is None or self._follows(self._rival, row) != "used":
            self._followers = 0
        self._rival, self._followers = row, self._followers + 1
        return "used" if self._followers > _BELIEVED else fate

    def _follows(self, before: Array, row: Array) -> str:
        """Whether one sample is what comes after another: used, or what is wrong."""
        step = float(row[0] - before[0])
        if step < 0.0:
            return "late"
        way = row[1 : 1 + self._n] - before[1 : 1 + self._n]
        square = float(way.dot(way))
        if step < _CLOSEST / self._rate or (
            square == 0.0 and np.array_equal(row[1:], before[1:])
        ):
            return "repeated"
        if step > self._reach:
            return "jumped"
        return "used" if square <= (self._speed * step) ** 2 else "implausible"

    def _is_torque(self, row: Array) -> bool:
        tau = row[1 + self._n : 1 + 2 * self._n]
        return float(tau.dot(tau)) <= self._torque**2

    def _go_on(self, row: Array) -> None:
        """The stream's clock goes on with a sample."""
        step = 1.0 / self._rate if self._last is None else float(row[0]) - self.now
        if step > 0:
            missing = max(0, round(step * self._rate) - 1 - self._between)
            if missing:
                self._count["missing"] += missing
                kept = (1.0 - self._news) ** min(missing, 1e9)
                self._lost = 1.0 - (1.0 - self._lost) * kept
        restart = self._followers > _BELIEVED
        self._count["restarts"] += restart
        self._clock += self._gap if restart else step
        self._last, self._rival, self._followers, self._between = row, None, 0, 0

    def _measure_rate(self, stamp: float) -> None:
        """Mean period; what is far from it counts little."""
        step = stamp - self._stamp
        self._stamp = stamp
        if step > 0:
            most = _STEP * self._period
            self._period += _GAIN * min(max(step - self._period, -most), most)
