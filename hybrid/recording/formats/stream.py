"""Messages of a topic with the same columns, in blocks that are given away once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array

FIRST = 4096  # rows of the first block; the next is as large as all before it
# Allocators give blocks above 32 MiB back to the system as soon as they are dropped.
_LARGEST = 5 << 20  # numbers in a block


class Stream:
    """Columns that grow block by block, without ever being copied as a whole."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.labels, self.rows = labels, 0
        self._stamps: list[NDArray[np.int64]] = []
        self._times: list[NDArray[np.int64]] = []
        self._blocks: list[Array] = []
        self._room = 0  # rows in all blocks

    def add(
        self,
        stamps: NDArray[np.int64],
        times: NDArray[np.int64],
        columns: list[NDArray[Any]],
    ) -> None:
        """Take rows: times in the messages and of the recorder, [ns], and numbers."""
        self._stamps.append(stamps)
        self._times.append(times)
        done = 0
        while done < len(times):
            if self.rows == self._room:
                widest = max(1, _LARGEST // max(1, len(columns)))
                rows = min(max(self.rows, FIRST), widest)
                self._blocks.append(np.empty((len(columns), rows)))
                self._room += rows
            block = self._blocks[-1]
            at = block.shape[1] - (self._room - self.rows)
            count = min(self._room - self.rows, len(times) - done)
            for own, x in zip(block, columns, strict=True):
                own[at : at + count] = x[done : done + count]
            self.rows, done = self.rows + count, done + count

    def clock(self) -> tuple[NDArray[np.int64], bool]:
        """Times of all rows, [ns], given away; whether they are the messages' own."""
        stamps, self._stamps = np.concatenate(self._stamps), []
        times, self._times = self._times, []
        headed = bool((stamps[1:] > stamps[:-1]).all())
        return (stamps if headed else np.concatenate(times)), headed

    def given(
        self, used: tuple[int, ...], clock: NDArray[np.int64]
    ) -> list[dict[int, NDArray[Any]]]:
        """The clock as column 0, and columns from 1; these are given away."""
        if used == (0,):
            return [{0: clock}]
        found, at = [], 0
        blocks, self._blocks = self._blocks, []
        for block in blocks:
            rows = clock[at : at + block.shape[1]]
            found.append(
                {k: rows if k == 0 else block[k - 1, : len(rows)] for k in used}
            )
            at += block.shape[1]
        return found
