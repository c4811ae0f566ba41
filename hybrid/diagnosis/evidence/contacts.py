"""When an arm touched something: stretches of a residual that one wrench explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import loudness
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects.contact import Contact

_CHUNK = 0.05  # s
_LENGTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192)  # chunks
_FAST = 0.1  # of a joint's highest speed
_NORMAL = 1.4826  # standard deviation over median size
_LONGEST = 1 / 3  # of a recording; what lasts is no event
_FORCE, _MOMENT = 20.0, 2.0  # N, N·m; prior standard deviations of the scan
_OF_ALL = -1  # recordings
_WORTH = 14.0  # nat: thousands of stretches are tried


@dataclass(frozen=True)
class _Clock:
    """Time cut into chunks, of all recordings together or of each its own.

    Attributes:
        chunk: Chunk of each sample of the gap, shape (M,).
        number: Place of each chunk in time, shape (C,), in lengths of a chunk.
        recording: Which recording a chunk is of, shape (C,).
    """

    chunk: NDArray[np.intp]
    number: NDArray[np.intp]
    recording: NDArray[np.intp]

    @classmethod
    def cut(cls, number: NDArray[np.intp], recording: NDArray[np.intp]) -> _Clock:
        """Chunks of samples with these numbers, each of shape (M,)."""
        both = np.stack([recording, number])
        (of, known), chunk = np.unique(both, axis=1, return_inverse=True)
        return cls(chunk.reshape(-1), known, of)

    def unbroken(self, length: int) -> NDArray[np.bool_]:
        """Whether chunks follow each other, from each on, shape (C − length + 1,)."""
        last = np.arange(length - 1, len(self.number))
        first = last - length + 1
        near = self.number[last] - self.number[first] < length
        return np.asarray(near & (self.recording[last] == self.recording[first]))


@dataclass(frozen=True, order=True)
class _Stretch:
    """A stretch of time, and the evidence for a wrench during it."""

    gain: float
    first: int
    length: int
    recording: int

    def overlaps(self, other: _Stretch) -> bool:
        ends = self.first + self.length, other.first + other.length
        return _meet(
            (self.recording, self.first, ends[0]),
            (other.recording, other.first, ends[1]),
        )


def _meet(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    """Whether two stretches, of a recording from a time to another, have any shared."""
    if len({a[0], b[0]} - {_OF_ALL}) > 1:
        return False
    return a[1] < b[2] and b[1] < a[2]


class Contacts:
    """Cross-products of the gap's wrench columns, chunk by chunk of time.

    What is in the way is so in every repeat, if recordings share a clock; or it was in
    the way only once.

    Args:
        gap: The gap.
    """

    def __init__(self, gap: Gap) -> None:
        n = gap.robot.size
        t = gap.sampled.t
        self._joints = tuple(range(n))
        v = np.abs(gap.sampled.v)
        # At low speed friction does whatever a contact might.
        self._fast = v > _FAST * v[gap.sampled.mask].max(axis=0, initial=0.0)
        self._first = float(t.min())
        number = ((t - self._first) / _CHUNK).astype(np.intp)
        self._clocks = [_Clock.cut(number, np.full(len(t), _OF_ALL))]
        own = _Clock.cut(number, gap.trajectory)
        if len(own.number) > len(self._clocks[0].number):
            self._clocks.append(own)
        always = {"start": self._first, "duration": float(np.ptp(t)) + 1.0}
        columns = gap.columns(Contact(self._joints, always))
        self._rate, self._cutoff = gap.rate, gap.cutoff
        self._columns = [columns[j] for j in self._joints]

    def strongest(
        self,
        left: Sequence[Array],
        rows: Sequence[NDArray[np.intp]],
        noise: Array,
        count: int,
    ) -> list[Contact]:
        """Contacts that explain most of a residual, none of them overlapping.

        Args:
            left: Residual of each joint, shape (R_i,), [N·m].
            rows: Samples of the gap that these are, shape (R_i,).
            noise: Variance of each joint, shape (n,), [N²·m²].
            count: How many contacts, at most. What may be noise is none; that is as
                large as at the time: where positions or times are coarse it comes in
                bursts.
        """
        sizes = [len(c.number) for c in self._clocks]
        gram = [np.zeros((size, 6, 6)) for size in sizes]
        moment = [np.zeros((size, 6)) for size in sizes]
        for i, (whole, among) in enumerate(zip(left, rows, strict=True)):
            fast = self._fast[among, i]
            x, r = whole[fast], among[fast]
            # The noise as known so far may hold the very contact.
            usual = (_NORMAL * np.median(np.abs(x))) ** 2 if len(x) else 0.0
            weight = 1.0 / (min(noise[i], usual) or noise[i])
            weight = weight / loudness(x, r, self._rate, self._cutoff)
            weighed = self._columns[i][r] * (x * weight)[:, None]
            for c, clock in enumerate(self._clocks):
                gram[c] += self._gram(c, i, r, weight)
                for k, column in enumerate(weighed.T):
                    moment[c][:, k] += np.bincount(clock.chunk[r], column, sizes[c])
        sums = zip(self._clocks, gram, moment, strict=True)
        stretches = [
            s for clock, G, m in sums for s in _stretches(clock, G, m)
            if s.gain > _WORTH
        ]  # fmt: skip
        found: list[_Stretch] = []
        for stretch in sorted(stretches, reverse=True):
            if not any(stretch.overlaps(x) for x in found):
                found.append(stretch)
            if len(found) == count:
                break
        return [
            Contact(
                self._joints,
                {
                    "start": self._first + _CHUNK * s.first,
                    "duration": _CHUNK * s.length,
                    "recording": float(s.recording),
                },
            )
            for s in found
        ]

    def _gram(self, c: int, i: int, rows: NDArray[np.intp], weight: Array) -> Array:
        """Products of a joint's columns on each chunk of a clock, shape (C, 6, 6)."""
        columns, chunk = self._columns[i][rows], self._clocks[c].chunk[rows]
        size = len(self._clocks[c].number)
        sums = [
            [np.bincount(chunk, weight * a * b, size) for b in columns.T]
            for a in columns.T
        ]
        return np.array(sums).transpose(2, 0, 1)


def _stretches(clock: _Clock, gram: Array, moment: Array) -> list[_Stretch]:
    """The best of each length, with the evidence for a wrench."""
    unit = np.array([_FORCE] * 3 + [_MOMENT] * 3)
    gram = np.concatenate([np.zeros((1, 6, 6)), gram * unit[:, None] * unit]).cumsum(0)
    moment = np.concatenate([np.zeros((1, 6)), moment * unit]).cumsum(0)
    longest = _LONGEST * np.unique(clock.recording, return_counts=True)[1].max()
    found = []
    for length in (x for x in _LENGTHS if x <= longest):
        A = np.eye(6) + gram[length:] - gram[:-length]
        b = moment[length:] - moment[:-length]
        solved = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        gain = 0.5 * np.einsum("ck,ck->c", b, solved) - 0.5 * np.linalg.slogdet(A)[1]
        gain = np.where(clock.unbroken(length), gain, 0.0)
        for k in np.argsort(-gain)[:8]:
            own = int(clock.number[k]), length, int(clock.recording[k])
            found.append(_Stretch(float(gain[k]), *own))
    return found
