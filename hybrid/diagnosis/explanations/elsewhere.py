"""An explanation on other samples than those that it was learnt from."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.gap.background import background, clocks, rest

if TYPE_CHECKING:
    from hybrid.diagnosis.explanations.posterior import Posterior


class Elsewhere:
    """Background and causes of a search on other samples, each evaluated once.

    Args:
        search: The posterior whose samples others were learnt from.
        use: The samples, shape (M,).

    Attributes:
        evidence: Their cross-products, weighed by the noise of the search.
        numbers: Columns of the file's numbers.
        rigid: Columns of the background: these, and what is open of any log.
        use: The samples.
    """

    def __init__(self, search: Posterior, use: NDArray[np.bool_]) -> None:
        # The search keeps this: together they would outlive their use.
        self._search, self.use, gap = proxy(search), use, search.gap
        self.evidence = Evidence(gap, use)
        self.evidence.noise = search.evidence.noise
        self.evidence.weigh(search.covariances)
        numbers, *more = (
            self.evidence.add(*x) for x in (background(gap), rest(gap), clocks(gap))
        )
        self.numbers = np.concatenate(numbers)
        self.evidence.spread(self.numbers, search.off)
        self.rigid = np.concatenate([self.numbers, *(x for part in more for x in part)])
        self._own: dict[Cause, Index] = {}

    def own(self, cause: Cause) -> Index:
        """Columns of a cause."""
        if cause not in self._own:
            columns = self._search.columns_of(cause)
            std = self._search.evidence.precision[cause.index] ** -0.5
            (self._own[cause],) = self.evidence.add([columns], [std])
        return self._own[cause]

    def columns(self, causes: Sequence[Cause]) -> Index:
        """Columns of the background and of some causes."""
        return np.concatenate([self.rigid, *map(self.own, causes)])

    def squares(self, causes: Sequence[Cause]) -> Array:
        """Squares that some causes leave as they were learnt, (n,), [N²·m²]."""
        squares = self.evidence.squares(self.columns(causes), self._gains(causes))
        return np.asarray(squares.sum(axis=1))

    def lost(self, causes: Sequence[Cause]) -> Array:
        """The same squares weighed by noise, shape (n,)."""
        return self.evidence.lost(self.columns(causes), self._gains(causes))

    def _gains(self, causes: Sequence[Cause]) -> Array:
        search = self._search
        return np.asarray(search.evidence.solve(search.columns(causes)).gains)

    @cached_property
    def count(self) -> Array:
        """Number of samples of each joint, shape (n,); not a number without any."""
        count = self.evidence.count.sum(axis=1).astype(float)
        return np.where(count > 0, count, np.nan)
