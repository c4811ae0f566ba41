"""When an arm touched something: stretches of a residual that one wrench explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.gap import Gap
from hybrid.effects.contact import Contact
from hybrid.robot.chain import Array

_CHUNK = 0.05  # s
_LENGTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192)  # chunks
_FAST = 0.1  # of a joint's highest speed
_NORMAL = 1.4826  # standard deviation over median size
_LONGEST = 1 / 3  # of a recording; what lasts is no event
_FORCE, _MOMENT = 20.0, 2.0  # N, N·m; prior standard deviations of the scan


class Contacts:
    """Cross-products of the gap's wrench columns, chunk by chunk of the clock.

    All recordings share the clock: what is in the way is so in every repeat.

    Args:
        gap: The gap.
    """

    def __init__(self, gap: Gap) -> None:
        n = gap.robot.size
        t = gap.sampled.t
        self._joints = tuple(range(n))
        v = np.abs(gap.sampled.v)
        # At low speed friction does whatever a contact might.
        self._fast = v > _FAST * v[gap.sampled.mask].max(axis=0)
        self._first = float(t.min())
        self._chunk = ((t - self._first) / _CHUNK).astype(int)
        always = {"start": self._first, "duration": float(np.ptp(t)) + 1.0}
        columns = gap.columns(Contact(self._joints, always))
        self._grams: dict[int, Array] = {}
        self._columns = [columns[j] for j in self._joints]

    def strongest(
        self,
        left: Sequence[Array],
        rows: Sequence[NDArray[np.intp]],
        noise: Array,
        count: int,
    ) -> list[Contact]:
        """Contacts that explain most of a residual, none of them overlapping.

        The samples must be the same at each call.

        Args:
            left: Residual of each joint, shape (R_i,), [N·m].
            rows: Samples of the gap that these are, shape (R_i,).
            noise: Variance of each joint, shape (n,), [N²·m²].
            count: How many contacts, at most.
        """
        size = int(self._chunk.max()) + 1
        gram, moment = np.zeros((size, 6, 6)), np.zeros((size, 6))
        for i, (whole, among) in enumerate(zip(left, rows, strict=True)):
            fast = self._fast[among, i]
            x, r = whole[fast], among[fast]
            # The noise as known so far may hold the very contact.
            usual = (_NORMAL * np.median(np.abs(x))) ** 2 if len(x) else 0.0
            weight = 1.0 / (min(noise[i], usual) or noise[i])
            gram += self._gram(i, r) * weight
            weighed = self._columns[i][r] * (x * weight)[:, None]
            for k, column in enumerate(weighed.T):
                moment[:, k] += np.bincount(self._chunk[r], column, size)
        windows = _windows(gram, moment)
        found: list[tuple[int, int]] = []
        for _, first, length in sorted(windows, reverse=True):
            apart = (first + length <= a or first >= a + b for a, b in found)
            if all(apart):
                found.append((first, length))
            if len(found) == count:
                break
        return [
            Contact(
                self._joints,
                {
                    "start": self._first + _CHUNK * first,
                    "duration": _CHUNK * length,
                },
            )
            for first, length in found
        ]

    def _gram(self, i: int, rows: NDArray[np.intp]) -> Array:
        """Products of a joint's columns on each chunk, shape (C, 6, 6)."""
        if i not in self._grams:
            columns, chunk = self._columns[i][rows], self._chunk[rows]
            size = int(self._chunk.max()) + 1
            sums = [
                [np.bincount(chunk, a * b, size) for b in columns.T] for a in columns.T
            ]
            self._grams[i] = np.array(sums).transpose(2, 0, 1)
        return self._grams[i]


def _windows(gram: Array, moment: Array) -> list[tuple[float, int, int]]:
    """Evidence for a wrench, first chunk and length: the best start of each length."""
    unit = np.array([_FORCE] * 3 + [_MOMENT] * 3)
    gram = np.concatenate([np.zeros((1, 6, 6)), gram * unit[:, None] * unit]).cumsum(0)
    moment = np.concatenate([np.zeros((1, 6)), moment * unit]).cumsum(0)
    found = []
    for length in _LENGTHS:
        if length > _LONGEST * (len(gram) - 1):
            break
        A = np.eye(6) + gram[length:] - gram[:-length]
        b = moment[length:] - moment[:-length]
        solved = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        gain = 0.5 * np.einsum("ck,ck->c", b, solved) - 0.5 * np.linalg.slogdet(A)[1]
        for k in np.argsort(-gain)[:8]:
            found.append((float(gain[k]), int(k), length))
    return found
