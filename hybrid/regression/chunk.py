"""The rows of a problem along a motion, one chunk of samples at a time."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hybrid.arrays import Array
from hybrid.regression.problem import Problem, part
from hybrid.signals import Motion, Sampler

_CHUNK = 16384  # samples processed at a time, at full rate
_GRADIENT_MARGIN = 16  # samples that numerical derivatives need on both sides


@dataclass(frozen=True)
class Chunk:
    """Some samples of a motion.

    Attributes:
        first: Index of the first decimated sample.
        motion: The samples, with those on both sides that the filter needs.
        sampler: Filter and decimation.
        inner: The samples without those on both sides.
        hold: Whether columns of links are held for the next problem; most problems on
            the same motion have the same.
        band: Bandwidth of the logged torque, [Hz], if its logger has filtered it.
    """

    first: int
    motion: Motion
    sampler: Sampler
    inner: slice
    hold: bool
    band: float = np.inf
    _links: dict[tuple[int, ...], tuple[Array, Array]] = field(default_factory=dict)

    def rows(self, problem: Problem) -> tuple[Array, Array]:
        """Rows of a problem, filtered and decimated, (P, M), and at full rate, (P, N).

        Columns and torque are filtered identically. Torque that its logger has filtered
        passes no other filter, and columns that one even at full rate.
        """
        if self.band < np.inf:
            full = problem.rows(self.motion)
            columns = np.ones(len(full), dtype=bool)
            columns[np.array(problem.offsets[1:]) - 1] = False
            low = Sampler(self.motion.rate, self.band, 1)
            full[columns] = low(full[columns], axis=1)
            D = full[:, :: self.sampler.factor]
        elif any(e.changes_signals for e in problem.effects):
            full = problem.rows(self.motion)
            D = self.sampler(full, axis=1)
        else:
            links, filtered = self._link_columns(problem)
            full, known = problem.rows(self.motion, links), problem.link_rows
            D = np.empty((len(full), filtered.shape[1]))
            D[known], D[~known] = filtered, self.sampler(full[~known], axis=1)
        few = slice(self.inner.start // self.sampler.factor, None)
        count = -(-(self.inner.stop - self.inner.start) // self.sampler.factor)
        return D[:, few][:, :count], full[:, self.inner]

    def _link_columns(self, problem: Problem) -> tuple[Array, Array]:
        """Columns of the links, at full rate, and filtered and decimated."""
        found = self._links.get(problem.link_entries)
        if found is None:
            links = problem.link_columns(self.motion)
            found = links, self.sampler(links, axis=1)
            if self.hold:
                self._links[problem.link_entries] = found
        return found


def chunks_along(
    motion: Motion, sampler: Sampler, *, hold: bool = False, band: float = np.inf
) -> Iterator[Chunk]:
    """Cut a motion into chunks.

    Chunks overlap by the length of the filter, so the result does not depend on them.
    """
    factor, total = sampler.factor, len(motion.t)
    margin = -(-max(sampler.margin, _GRADIENT_MARGIN) // factor) * factor
    chunk = max(_CHUNK, 4 * margin) // factor * factor
    for start in range(0, total, chunk):
        before, stop = max(0, start - margin), min(total, start + chunk)
        few = part(motion, slice(before, min(total, stop + margin)))
        inner = slice(start - before, stop - before)
        yield Chunk(start // factor, few, sampler, inner, hold, band)
