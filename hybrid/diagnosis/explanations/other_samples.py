"""An explanation on other samples than those of its search."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import proxy

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.gap.background import (
    background,
    friction_near_rest,
    sampling_delays,
)
from hybrid.diagnosis.prior import Prior

if TYPE_CHECKING:
    from hybrid.diagnosis.explanations.posterior import Posterior

TAIL = 0.02  # of a term's squares, which a filter may spread to other samples


def add_background(evidence: Evidence, prior: Prior) -> tuple[Index, list[Index]]:
    """Add the columns of the background, the file's numbers with their typical error.

    Returns:
        All columns, and those of each block of numbers; see :func:`.background`.
    """
    gap = evidence.gap
    numbers = evidence.add(*background(gap))
    evidence.scale_prior(np.concatenate(numbers), prior.file_errors[1])
    others = evidence.add(*friction_near_rest(gap))
    others += evidence.add(*sampling_delays(gap))
    return np.concatenate([*numbers, *others]), numbers


class OtherSamples:
    """Background and causes of a search on other samples.

    Args:
        use: The samples, shape (M,).

    Attributes:
        evidence: Their cross-products, with the noise of the search.
        numbers: Columns of the links' numbers in the file.
        rigid: Columns of the background.
        use: The samples.
    """

    def __init__(self, search: Posterior, use: Mask) -> None:
        # A reference would be a cycle, which keeps the search's memory alive.
        self._search, self.use, gap = proxy(search), use, search.gap
        self.evidence = Evidence(gap, use)
        self.evidence.noise = search.evidence.noise
        noise = search.noise
        self.evidence.set_covariances(noise.covariances, noise.sizes)
        self.rigid, numbers = add_background(self.evidence, search.prior)
        self.numbers = np.concatenate(numbers[: gap.robot.size])
        self.evidence.scale_prior(self.numbers, search.file_error)
        self._own: dict[Cause, Index] = {}

    def own(self, cause: Cause) -> Index:
        """Columns of a cause, which are evaluated once."""
        if cause not in self._own:
            columns = self._search.columns_of(cause)
            std = self._search.evidence.precision[cause.index] ** -0.5
            (self._own[cause],) = self.evidence.add([columns], [std])
        return self._own[cause]

    def columns(self, causes: Sequence[Cause]) -> Index:
        """Columns of the background and of some causes."""
        return np.concatenate([self.rigid, *map(self.own, causes)])

    def squares(self, causes: Sequence[Cause]) -> Array:
        """Residual squares with the gains of the search, shape (n,), [N²·m²]."""
        return self.evidence.squares(self.columns(causes), self._gains(causes))

    def weighted_squares(self, causes: Sequence[Cause]) -> Array:
        """The same, weighted by the noise, shape (n,)."""
        gains = self._gains(causes)
        return self.evidence.weighted_squares(self.columns(causes), gains)

    def residuals(self, causes: Sequence[Cause]) -> list[Array]:
        """Residual of each joint with the gains of the search, [N·m]."""
        return self.evidence.residuals(self.columns(causes), self._gains(causes))

    def tests(self, cause: Cause, causes: Sequence[Cause]) -> bool:
        """Whether one of some causes acts here, and not on the search's samples alone.

        What happens once cannot be tested.
        """
        search = self._search.evidence
        gains = search.solve(self._search.columns(causes)).of(cause.index)
        here = self.evidence.fitted_squares(self.own(cause), gains)
        there = search.fitted_squares(cause.index, gains)
        return bool(here.sum() > TAIL * there.sum())

    def _gains(self, causes: Sequence[Cause]) -> Array:
        search = self._search
        return np.asarray(search.evidence.solve(search.columns(causes)).gains)

    @cached_property
    def count(self) -> Array:
        """Number of samples of each joint, shape (n,); NaN where there is none."""
        return np.where(self.evidence.count > 0, self.evidence.count, np.nan)
