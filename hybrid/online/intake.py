"""Acceptance of the samples of a stream, and their grouping into blocks."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.online.health import Health
from hybrid.signals.streaming import STRETCH

_RESTART_AFTER = 10  # rejected samples that follow each other
_CLOSEST = 0.1  # of a period: two samples that are closer are repeated
_LARGEST, _LATEST = 1e6, 1e15  # largest signal, and time stamp, in SI units
_MEMORY = 1.0  # s, time constant of the share of lost samples
_RATE_GAIN = 0.05  # weight of a new period in the mean
_RATE_STEP = 0.1  # largest relative deviation of a new period that counts


@dataclass(frozen=True)
class Sample:
    """The signals of an arm at one instant.

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
    """Accepts or rejects samples, and groups the accepted ones into blocks.

    A sample is accepted if it follows the last one soon enough for the window, and no
    faster than ``speed``. Otherwise it is rejected. If ten rejected samples follow each
    other, the stream restarts from them, after a gap in its own clock that no window
    bridges.

    Args:
        size: Number of joints n.
        rate: Samples per second, [Hz].
        window: Time over which samples are differentiated, [s]; 0 if they contain speed
            and acceleration.
        speed: Largest plausible norm of the joint speeds, [rad/s].
        torque: Largest plausible norm of the joint torques, [N·m].
        before: Past samples that a block contains.
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
        self._n, self._rate, self._signals = size, rate, 2 if window else 4
        self._reach = (STRETCH - 1.0) * window if window else math.inf
        self._gap = max(STRETCH * window, 1.0 / rate)
        self._speed, self._torque = speed if window else math.inf, torque
        self._rows = np.zeros((before + block, 1 + self._signals * size))
        self._before, self._filled, self._clock = before, 0, 0.0
        self._last: Array | None = None
        self._candidate: Array | None = None
        self._followers = self._between = 0
        self._stamp, self._period = math.nan, 1.0 / rate
        self._lost, self._gain = 0.0, 1.0 / (1.0 + rate * _MEMORY)
        self._count = Counter[str]()  # by the names of Health

    @property
    def now(self) -> float:
        """Time stamp of the last accepted sample, [s]."""
        return math.nan if self._last is None else float(self._last[0])

    @property
    def health(self) -> Health:
        """Counts of the samples so far."""
        rate = 1.0 / self._period
        return Health(**self._count, lost=self._lost, rate=rate, stated_rate=self._rate)

    def take(self, sample: Sample) -> Array | None:
        """Accept or reject a sample.

        Returns:
            The rows of a block with the past ones, if it is full, else None. A row has
            the stream's own time, [s], position and torque, then speed and acceleration
            if samples contain them.
        """
        row = self._row(sample)
        outcome = self._outcome(row)
        self._count["received"] += 1
        self._count[outcome] += 1
        self._lost += (float(outcome != "used") - self._lost) * self._gain
        if outcome != "used":
            self._between += outcome not in ("late", "repeated")
            return None
        self._advance(row)
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
        if self._signals == 4:
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
        if {np.size(x) for x in parts[1:]} != {self._n}:
            raise IdentificationError(
                f"a sample has {row.size - 1} numbers beside its time; valid are "
                f"{self._n} of each kind, {self._rows.shape[1] - 1} in all"
            )
        return row

    def _outcome(self, row: Array) -> str:
        """``used``, or why a sample is rejected."""
        stamp, largest = float(row[0]), float(np.abs(row[1:]).max())
        if not (math.isfinite(stamp) and math.isfinite(largest)):
            return "not_finite"
        tau = row[1 + self._n : 1 + 2 * self._n]
        too_large = largest > _LARGEST or float(tau.dot(tau)) > self._torque**2
        if too_large or abs(stamp) > _LATEST:
            return "implausible"
        self._measure_rate(stamp)
        if self._last is None:
            return "used"
        outcome = self._follows(self._last, row)
        if outcome in ("used", "repeated"):
            return outcome
        if self._candidate is None or self._follows(self._candidate, row) != "used":
            self._followers = 0
        self._candidate, self._followers = row, self._followers + 1
        return "used" if self._followers > _RESTART_AFTER else outcome

    def _follows(self, before: Array, row: Array) -> str:
        """``used`` if one sample can follow another, or why it cannot."""
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

    def _advance(self, row: Array) -> None:
        """Advance the stream's clock with an accepted sample."""
        step = 1.0 / self._rate if self._last is None else float(row[0]) - self.now
        if step > 0:
            missing = max(0, round(step * self._rate) - 1 - self._between)
            if missing:
                self._count["missing"] += missing
                kept = (1.0 - self._gain) ** min(missing, 1e9)
                self._lost = 1.0 - (1.0 - self._lost) * kept
        restart = self._followers > _RESTART_AFTER
        self._count["restarts"] += restart
        self._clock += self._gap if restart else step
        self._last, self._candidate, self._followers, self._between = row, None, 0, 0

    def _measure_rate(self, stamp: float) -> None:
        """Update the mean period; outliers are clipped."""
        step = stamp - self._stamp
        self._stamp = stamp
        if step > 0:
            most = _RATE_STEP * self._period
            self._period += _RATE_GAIN * min(max(step - self._period, -most), most)
