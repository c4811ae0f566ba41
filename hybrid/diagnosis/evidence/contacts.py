"""Contacts of the arm: stretches of a residual that constant gains explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect
from hybrid.statistics import robust_std

_CHUNK = 0.05  # s, or a sample if that is longer
_LENGTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192)  # chunks
_FAST = 0.1  # of a joint's highest speed
_LONGEST = 1 / 3  # of a recording
_SPREAD = 2.0  # times the typical gain, prior standard deviation of the scan
_OF_ALL = -1  # number that stands for all recordings
_CONSTANT = 0.5  # of the torque, that a constant one leaves of one that rises and falls
_RISES = 0.0, 0.5  # of a contact's duration, before it is fitted
_WORTH = 14.0  # nat, odds against one of some thousand stretches


@dataclass(frozen=True)
class _Clock:
    """Time divided into chunks, of each recording or of all recordings together.

    Attributes:
        chunk: Chunk of each sample of the gap, shape (M,).
        number: Start of each chunk, shape (C,), in lengths of a chunk.
        recording: Recording of each chunk, shape (C,).
    """

    chunk: Index
    number: Index
    recording: Index

    @classmethod
    def cut(cls, number: Index, recording: Index) -> _Clock:
        """Make chunks of samples with the same number and recording, (M,) each."""
        both = np.stack([recording, number])
        (of, known), chunk = np.unique(both, axis=1, return_inverse=True)
        return cls(chunk.reshape(-1), known, of)

    def sums(self, rows: Index, x: Array) -> Array:
        """Sum of some samples' values, shape (R, ...), over each chunk, (C, ...)."""
        chunk, size = self.chunk[rows], len(self.number)
        flat = x.reshape(-1, int(np.prod(x.shape[1:])))
        sums = np.array([np.bincount(chunk, y, size) for y in flat.T], dtype=float)
        return sums.T.reshape(size, *x.shape[1:])

    def unbroken(self, length: int) -> Mask:
        """Whether a number of chunks from each on is contiguous, (C − length + 1,)."""
        last = np.arange(length - 1, len(self.number))
        first = last - length + 1
        near = self.number[last] - self.number[first] < length
        return np.asarray(near & (self.recording[last] == self.recording[first]))


@dataclass(frozen=True, order=True)
class _Stretch:
    """A stretch of time, and the evidence for a contact during it."""

    gain: float
    first: int
    length: int
    recording: int

    def meets(self, other: _Stretch) -> bool:
        """Whether two stretches of a recording overlap or touch."""
        if len({self.recording, other.recording} - {_OF_ALL}) > 1:
            return False
        before = self.first <= other.first + other.length
        return before and other.first <= self.first + self.length


class Contacts:
    """Search for contacts, over stretches of one recording and of all of them.

    An obstacle is met at the same time in every repeat of a motion, or only once.

    Args:
        law: A law that acts from a start for a duration; see :attr:`.Effect.repeats`.
    """

    def __init__(self, gap: Gap, law: type[Effect]) -> None:
        n = gap.robot.size
        self._law = law
        self._std = _SPREAD * np.array([g.typical for g in law.gains])
        t = gap.sampled.t
        self._joints = tuple(range(n))
        v = np.abs(gap.sampled.v)
        # At low speed, errors of the friction look like a contact.
        self._fast = v > _FAST * v[gap.sampled.mask].max(axis=0, initial=0.0)
        self._first = float(t.min())
        # Slightly less than a sample, so that each one begins a chunk of its own.
        self._chunk = max(_CHUNK, (1.0 - 1e-6) / gap.rate)
        number = ((t - self._first) / self._chunk).astype(np.intp)
        self._clocks = [_Clock.cut(number, np.full(len(t), _OF_ALL))]
        own = _Clock.cut(number, gap.trajectory)
        if len(own.number) > len(self._clocks[0].number):
            self._clocks.append(own)
        always = {"start": self._first, "duration": float(np.ptp(t)) + 1.0}
        columns = gap.columns(law(self._joints, always))
        self._columns = [columns[j] for j in self._joints]

    def strongest(
        self,
        left: Sequence[Array],
        rows: Sequence[Index],
        noise: Array,
        count: int,
    ) -> list[Effect]:
        """Contacts that explain most of a residual, which do not meet.

        Each is given twice: of a constant force, and of one that rises and falls.

        Args:
            left: Residual of each joint, shape (R_i,), [N·m].
            rows: Samples of the gap of each residual, shape (R_i,).
            noise: Noise variance of each joint, shape (n,), [N²·m²].
            count: Largest number of stretches.
        """
        p = len(self._std)
        shapes = (p, p), (p,), (), ()
        sums = [[np.zeros((len(c.number), *x)) for x in shapes] for c in self._clocks]
        for i, (whole, among) in enumerate(zip(left, rows, strict=True)):
            fast = self._fast[among, i]
            x, r = whole[fast], among[fast]
            # The estimate of the noise may contain the contact.
            std = np.sqrt(min(noise[i], robust_std(x) ** 2) or noise[i])
            x, columns = x / std, self._columns[i][r] * self._std / std
            pairs = columns[:, :, None] * columns[:, None]
            parts = pairs, columns * x[:, None], x**2, np.ones(len(x))
            for clock, own in zip(self._clocks, sums, strict=True):
                for total, part in zip(own, parts, strict=True):
                    total += clock.sums(r, part)
        each = zip(self._clocks, sums, strict=True)
        every = (s for clock, own in each for s in _stretches(clock, *own))
        stretches = [s for s in every if s.gain > _WORTH]
        found: list[_Stretch] = []
        for stretch in sorted(stretches, reverse=True):
            if not any(stretch.meets(x) for x in found):
                found.append(stretch)
        return [self._contact(s, rise) for s in found[:count] for rise in _RISES]

    def _contact(self, stretch: _Stretch, rise: float) -> Effect:
        """A contact that has more than half of its force during a stretch."""
        duration = self._chunk * stretch.length / (1.0 - rise / 2)
        middle = self._first + self._chunk * (stretch.first + stretch.length / 2)
        times = {
            "start": max(middle - duration / 2, 0.0),
            "duration": duration,
            "rise": rise,
            "recording": float(stretch.recording),
        }
        return self._law(self._joints, times)


def _stretches(
    clock: _Clock, gram: Array, moment: Array, power: Array, count: Array
) -> list[_Stretch]:
    """The best stretches of each length, with the evidence for a contact.

    Args:
        clock: The chunks.
        gram: Products of the columns over each chunk, in units of the prior and of the
            noise, shape (C, p, p).
        moment: Their products with the residual, shape (C, p).
        power: Squares of the residual, shape (C,).
        count: Number of samples, shape (C,).
    """
    sums = [
        np.concatenate([np.zeros_like(x[:1]), x]).cumsum(0)
        for x in (gram, moment, power, count)
    ]
    longest = _LONGEST * np.unique(clock.recording, return_counts=True)[1].max()
    found = []
    for length in (x for x in _LENGTHS if x <= longest):
        G, b, before, size = (x[length:] - x[:-length] for x in sums)
        A = np.eye(G.shape[-1]) + G
        gains = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        explained = np.einsum("ck,ck->c", b, gains)
        gain = 0.5 * explained - 0.5 * np.linalg.slogdet(A)[1]
        rest = before - explained - np.sum(gains**2, axis=1) - size
        all_of_it = rest < _CONSTANT**2 * before
        # Of those that differ by unused samples only, the shortest is the most likely.
        gain -= np.log(length)
        gain = np.where(clock.unbroken(length) & all_of_it, gain, 0.0)
        for k in np.argsort(-gain)[:8]:
            own = int(clock.number[k]), length, int(clock.recording[k])
            found.append(_Stretch(float(gain[k]), *own))
    return found
