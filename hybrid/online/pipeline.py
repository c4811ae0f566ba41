"""Conversion of a block of samples to one regression row, in small tasks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hybrid.arrays import Array
from hybrid.online.columns import InstantColumns
from hybrid.online.layout import RowLayout
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial


class Pipeline:
    """Turns a block of samples into one filtered row.

    A block consists of B groups of samples. A group has the mean torque of its samples,
    and one row; these rows are filtered to one.

    Args:
        columns: Columns of an arm and its effects at B instants.
        layout: Layout of a row.
        group: Number of samples g in a group.
        differentiator: Differentiates positions; None if samples contain speed and
            acceleration.
        low_pass: Filter of the rows; None to use the last row of each block.
        standing: Speed below which a joint stands, shape (n,), [rad/s].
    """

    def __init__(
        self,
        columns: InstantColumns,
        layout: RowLayout,
        *,
        group: int,
        differentiator: LocalPolynomial | None,
        low_pass: BlockLowPass | None,
        standing: Array,
    ) -> None:
        self._columns, self._layout = columns, layout
        self._mean = np.kron(np.eye(len(columns.rows)), np.full(group, 1.0 / group))
        self._differentiator, self._low_pass, self._standing = (
            differentiator,
            low_pass,
            standing,
        )
        self.row = np.zeros(len(layout.joints))
        self._regular = np.ones(1, dtype=bool)
        self.tasks: list[Callable[[], None]] = [
            *(self._derivative_tasks(differentiator) if differentiator else ()),
            self._find_states,
            *columns.tasks,
            self._filter,
        ]

    def begin(self, samples: Array, theta: Array) -> None:
        """Set the block that the tasks work on.

        Args:
            samples: Time, position, torque, then speed and acceleration if samples
                contain them, for the block and its margins, shape (N, width).
            theta: Unknowns, shape (d,).
        """
        self._samples, self._theta = samples, theta

    @property
    def time(self) -> float:
        """Time of the newest sample of the block, [s]."""
        return float(self._samples[-1, 0])

    def _derivative_tasks(
        self, differentiator: LocalPolynomial
    ) -> list[Callable[[], None]]:
        """Tasks that find the states of all groups, and which of them are valid."""

        def windows() -> None:
            self._powers, self._trusted = differentiator.windows(self._samples[:, 0])
            self._q = self._samples[:, 1 : 1 + len(self._standing)]
            self._moments = differentiator.moments(self._powers, self._q)

        def fit() -> None:
            self._fitted = differentiator.fit(self._moments)

        def left() -> None:
            self._left = differentiator.residual(self._powers, self._q, self._fitted)
            self._states = differentiator.states(self._fitted)

        def spread() -> None:
            # At standstill a single step of the encoder is normal.
            stands = np.abs(self._states[1]) <= self._standing
            here = (differentiator.has_no_outlier(self._left) | stands).all(axis=1)
            self._regular = np.append(self._regular[-1], here)

        return [windows, fit, left, spread]

    def _find_states(self) -> None:
        margin, n = (
            self._differentiator.margin if self._differentiator else 0,
            len(self._standing),
        )
        mean = self._mean @ self._samples[margin : len(self._samples) - margin]
        t, signals = mean[:, 0], mean[:, 1:]
        self._tau = signals[:, n : 2 * n]
        if self._differentiator is None:
            q, v, a = signals[:, :n], signals[:, 2 * n : 3 * n], signals[:, 3 * n :]
            self._moving = np.abs(v) > self._standing
        else:
            # An outlier at the end of a window shows only in the next window.
            self._trusted &= self._regular[1:] & self._regular[:-1]
            self._trusted[:-1] &= self._regular[2:]
            q, v, a = self._states
            self._moving = (np.abs(v) > self._standing) & self._trusted[:, None]
        self._columns.begin((t, q, v, a), self._theta)

    def _filter(self) -> None:
        """Filter columns and torque identically; those of standing joints are 0."""
        rows, layout = self._columns.rows, self._layout
        rows[:, layout.torque], rows[:, layout.moving] = self._tau, 1.0
        rows *= self._moving[:, layout.joints]
        if not np.isfinite(rows.sum()):  # a law has no value there: leave the row out
            rows[~np.isfinite(rows).all(axis=1)] = 0.0
        self.row = rows[-1] if self._low_pass is None else self._low_pass(rows)
