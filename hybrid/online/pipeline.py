"""From a block of samples to one row of a regression, in small tasks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hybrid.arrays import Array
from hybrid.online.columns import InstantColumns
from hybrid.online.layout import RowLayout
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial


class Pipeline:
    """States, columns and torque of a block, filtered to one flat row.

    Samples are taken in groups: a group has the mean of its samples' torque, and one
    row. A block of B groups gives one filtered row.

    Args:
        columns: Columns of an arm and its effects at B instants.
        layout: What is where in a row.
        group: Samples in a group g.
        derive: Differentiates positions; None if samples bring speed and acceleration.
        smooth: Low-pass of rows; None to take the last of each block.
        standing: Speed below which a joint stands, shape (n,), [rad/s].
    """

    def __init__(
        self,
        columns: InstantColumns,
        layout: RowLayout,
        *,
        group: int,
        derive: LocalPolynomial | None,
        smooth: BlockLowPass | None,
        standing: Array,
    ) -> None:
        self._columns, self._layout = columns, layout
        self._mean = np.kron(np.eye(len(columns.rows)), np.full(group, 1.0 / group))
        self._derive, self._smooth, self._standing = derive, smooth, standing
        self.row = np.zeros(len(layout.joints))
        self._spread = np.ones(1, dtype=bool)
        self.tasks: list[Callable[[], None]] = [
            *(self._derivative_tasks(derive) if derive else ()),
            self._find_states,
            *columns.tasks,
            self._filter,
        ]

    def begin(self, samples: Array, theta: Array) -> None:
        """Start with a block and the margins that it needs.

        Args:
            samples: Time, position and torque, and speed and acceleration if samples
                bring them, shape (N, width).
            theta: Unknowns, shape (d,).
        """
        self._samples, self._theta = samples, theta

    @property
    def time(self) -> float:
        """Time of the newest sample in it, [s]."""
        return float(self._samples[-1, 0])

    def _derivative_tasks(self, derive: LocalPolynomial) -> list[Callable[[], None]]:
        """What finds the states at all groups, and which of them to trust."""

        def windows() -> None:
            self._powers, self._trusted = derive.windows(self._samples[:, 0])
            self._q = self._samples[:, 1 : 1 + len(self._standing)]
            self._moments = derive.moments(self._powers, self._q)

        def fit() -> None:
            self._fitted = derive.fit(self._moments)

        def left() -> None:
            self._left = derive.residual(self._powers, self._q, self._fitted)
            self._states = derive.states(self._fitted)

        def spread() -> None:
            # Of a joint that stands one step of the encoder is all there is.
            stands = np.abs(self._states[1]) <= self._standing
            here = (derive.has_no_outlier(self._left) | stands).all(axis=1)
            self._spread = np.append(self._spread[-1], here)

        return [windows, fit, left, spread]

    def _find_states(self) -> None:
        margin, n = self._derive.margin if self._derive else 0, len(self._standing)
        mean = self._mean @ self._samples[margin : len(self._samples) - margin]
        t, signals = mean[:, 0], mean[:, 1:]
        self._tau = signals[:, n : 2 * n]
        if self._derive is None:
            q, v, a = signals[:, :n], signals[:, 2 * n : 3 * n], signals[:, 3 * n :]
            self._moving = np.abs(v) > self._standing
        else:
            # A wrong sample at its very end bends a window and leaves no trace in it,
            # but in the one beside.
            self._trusted &= self._spread[1:] & self._spread[:-1]
            self._trusted[:-1] &= self._spread[2:]
            q, v, a = self._states
            self._moving = (np.abs(v) > self._standing) & self._trusted[:, None]
        self._columns.begin((t, q, v, a), self._theta)

    def _filter(self) -> None:
        """Rows and torque through the same filter; of joints that stand they are 0."""
        rows, layout = self._columns.rows, self._layout
        rows[:, layout.torque], rows[:, layout.moving] = self._tau, 1.0
        rows *= self._moving[:, layout.joints]
        if not np.isfinite(rows.sum()):  # a law has no value there; 0 tells nothing
            rows[~np.isfinite(rows).all(axis=1)] = 0.0
        self.row = rows[-1] if self._smooth is None else self._smooth(rows)
