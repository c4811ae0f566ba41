"""Collect messages with the same columns in blocks that can be taken once."""

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import AnyArray, Array

# Memory of blocks above 32 MiB returns to the system as soon as they are deleted.
BLOCK = 5 << 20  # numbers in a block


class Stream:
    """Columns of numbers that grow block by block, without a copy of all of them."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.labels = labels
        self._clocks: list[NDArray[np.int64]] = []  # of messages, and of the recorder
        self._blocks: list[Array] = []  # each of shape (columns, rows)
        self._parts: list[Array] = []  # of the next block

    def add(
        self,
        stamps: NDArray[np.int64],
        times: NDArray[np.int64],
        columns: list[AnyArray],
    ) -> None:
        """Add rows: times of messages and of the recorder, [ns], and numbers."""
        self._clocks.append(np.stack([stamps, times]))
        part = np.array(columns, dtype=float)
        self._parts.append(part.reshape(len(columns), len(times)))
        if sum(part.size for part in self._parts) >= BLOCK:
            self._close()

    def _close(self) -> None:
        if self._parts:
            self._blocks.append(np.concatenate(self._parts, axis=1))
            self._parts = []

    def clock(self) -> tuple[NDArray[np.int64], bool]:
        """Take the times of all rows, [ns], and whether they are those of messages."""
        self._close()
        (stamps, times), self._clocks = np.concatenate(self._clocks, axis=1), []
        own = bool(stamps.any() and (stamps[1:] > stamps[:-1]).all())
        return (stamps if own else times), own

    def take(
        self, used: tuple[int, ...], clock: NDArray[np.int64]
    ) -> list[dict[int, AnyArray]]:
        """Take columns from 1, which the stream then has no more; the clock is 0."""
        if used == (0,):
            return [{0: clock}]
        blocks, self._blocks = self._blocks, []
        ends = np.cumsum([block.shape[1] for block in blocks])[:-1]
        rows = np.split(clock, ends)
        return [
            {k: part if k == 0 else block[k - 1] for k in used}
            for block, part in zip(blocks, rows, strict=True)
        ]
