"""Whitened columns of effects along motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Candidate
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.shapes import shape_derivatives
from hybrid.diagnosis.gap.background import (
    background,
    friction_near_rest,
    sampling_delays,
)
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.regression.problem import part


class WhitenedColumns:
    """Columns of effects along some motions, in units of noise.

    Args:
        gap: The motions.
        noise: Variance of each joint's noise for independent samples, shape (n,).
        rows: Samples of each joint to use; by default all in which it moves.
    """

    def __init__(
        self, gap: Gap, noise: Array, rows: Sequence[Index] | None = None
    ) -> None:
        self.gap = gap
        moving = [np.flatnonzero(x) for x in gap.moving.T]
        self.rows = moving if rows is None else list(rows)
        self._unit = 1.0 / np.sqrt(noise)
        self._cached: dict[Candidate, Columns] = {}

    def columns(self, effect: Effect) -> Columns:
        """Torque per unit of each gain, shape (R, p) at each joint that is reached."""
        return self._whitened(self.gap.columns(effect))

    def cached(self, candidate: Candidate) -> Columns:
        """The columns of a candidate, computed once."""
        if candidate not in self._cached:
            self._cached[candidate] = self.columns(candidate.effect)
        return self._cached[candidate]

    def with_shapes(self, effect: Effect) -> list[Columns]:
        """Columns of an effect, and of small changes of its shapes."""
        changes = [self._whitened(x) for x in shape_derivatives(self.gap, effect)]
        return [self.columns(effect), *changes]

    @cached_property
    def background(self) -> list[Columns]:
        """Columns of the simulator's own numbers."""
        makers = background, friction_near_rest, sampling_delays
        return [self._whitened(x) for make in makers for x in make(self.gap)[0]]

    @cached_property
    def residual(self) -> list[Array]:
        """Gap at each joint, shape (R,)."""
        return [self.gap.left[r, i] * self._unit[i] for i, r in enumerate(self.rows)]

    def stack(self, blocks: Sequence[Columns]) -> list[Array]:
        """Stack columns at every joint, shape (R, k) each; zero where there is none."""
        widths = [next(iter(b.values())).shape[1] for b in blocks]
        starts = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        found = []
        for i, rows in enumerate(self.rows):
            X = np.zeros((len(rows), starts[-1]))
            for block, start, width in zip(blocks, starts[:-1], widths, strict=True):
                if i in block:
                    X[:, start : start + width] = block[i]
            found.append(X)
        return found

    def _whitened(self, columns: Columns) -> Columns:
        return {i: x[self.rows[i]] * self._unit[i] for i, x in columns.items()}


def decimated(gap: Gap) -> Gap:
    """A gap with decimated motions, so that columns of effects take less time."""
    pairs = [(part(m, slice(None, None, s.factor)), b) for m, b, s in gap]
    return replace(
        gap,
        motions=tuple(m for m, _ in pairs),
        bodies=tuple(RigidBody(b.chain, m, b.inertial) for m, b in pairs),
    )
