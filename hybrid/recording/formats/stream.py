"""Messages of a topic with the same columns, in blocks that are given away once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array

# Allocators give blocks above 32 MiB back to the system as soon as they are dropped.
BLOCK = 5 << 20  # numbers in a block


class Stream:
    """Columns of numbers that grow block by block, never copied as a whole."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.labels = labels
        self._stamps: list[NDArray[np.int64]] = []
        self._times: list[NDArray[np.int64]] = []
        self._blocks: list[Array] = []  # each of shape (columns, rows)
        self._parts: list[Array] = []  # of the next block

    def add(
        self,
        stamps: NDArray[np.int64],
        times: NDArray[np.int64],
        columns: list[NDArray[Any]],
    ) -> None:
        """Take rows: times in the messages and of the recorder, [ns], and numbers."""
        self._stamps.append(stamps)
        self._times.append(times)
        part = np.empty((len(columns), len(times)))
        for own, x in zip(part, columns, strict=True):
            own[:] = x
        self._parts.append(part)
        if sum(part.size for part in self._parts) >= BLOCK:
            self._close()

    def _close(self) -> None:
        if self._parts:
            self._blocks.append(np.concatenate(self._parts, axis=1))
            self._parts = []

    def clock(self) -> tuple[NDArray[np.int64], bool]:
        """Times of all rows, [ns], given away; whether they are the messages' own."""
        self._close()
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
        blocks, self._blocks = self._blocks, []
        ends = np.cumsum([block.shape[1] for block in blocks])[:-1]
        rows = np.split(clock, ends)
        return [
            {k: part if k == 0 else block[k - 1] for k in used}
            for block, part in zip(blocks, rows, strict=True)
        ]
