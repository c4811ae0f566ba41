"""Conversion of a block of samples to one regression row, in small steps."""

from collections.abc import Generator

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.online.columns import InstantColumns
from hybrid.online.layout import MOVING, TORQUE
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial

States = tuple[Array, Array, Array]  # position, speed and acceleration, (B, n) each


class Pipeline:
    """Turns a block of samples into one filtered row.

    A block consists of B groups of ``group`` samples. A group has the mean torque of
    its samples, and one row; these rows are filtered to one, or the last one is used.
    Positions are differentiated unless samples contain speed and acceleration. A joint
    stands below the speed ``standing``, shape (n,), [rad/s].
    """

    def __init__(
        self,
        columns: InstantColumns,
        *,
        group: int,
        differentiator: LocalPolynomial | None,
        low_pass: BlockLowPass | None,
        standing: Array,
    ) -> None:
        self._columns = columns
        self._mean = np.kron(np.eye(len(columns.rows)), np.full(group, 1.0 / group))
        self._differentiator, self._low_pass = differentiator, low_pass
        self._standing = standing
        self._regular = np.ones(1, dtype=bool)

    def row(self, samples: Array, theta: Array) -> Generator[None, None, Array]:
        """The filtered row of a block, shape (n, columns), in steps.

        The samples are those of :meth:`Intake.take`, with margins; the unknowns have
        the shape (d,).
        """
        n, margin = len(self._standing), 0
        if self._differentiator is not None:
            margin = self._differentiator.margin
            states, trusted = yield from self._states(self._differentiator, samples)
        t, signals = np.split(
            self._mean @ samples[margin : len(samples) - margin], [1], axis=1
        )
        if self._differentiator is None:
            states = signals[:, :n], signals[:, 2 * n : 3 * n], signals[:, 3 * n :]
            trusted = np.ones(len(t), dtype=bool)
        moving = (np.abs(states[1]) > self._standing) & trusted[:, None]
        yield
        yield from self._columns.fill((t[:, 0], *states), theta)
        # Columns and torque are filtered identically; those of standing joints are 0.
        rows = self._columns.rows
        rows[:, :, TORQUE], rows[:, :, MOVING] = signals[:, n : 2 * n], 1.0
        rows *= moving[:, :, None]
        if not np.isfinite(rows.sum()):  # a law has no value there: leave the row out
            rows[~np.isfinite(rows).all(axis=(1, 2))] = 0.0
        row: Array = rows[-1]
        if self._low_pass is not None:
            row = self._low_pass(rows.reshape(len(rows), -1)).reshape(row.shape)
        yield
        return row

    def _states(
        self, differentiator: LocalPolynomial, samples: Array
    ) -> Generator[None, None, tuple[States, Mask]]:
        """The states of all groups, and which of them can be trusted."""
        q = samples[:, 1 : 1 + len(self._standing)]
        powers, trusted = differentiator.windows(samples[:, 0])
        moments = differentiator.moments(powers, q)
        yield
        fitted = differentiator.fit(moments)
        yield
        left = differentiator.residual(powers, q, fitted)
        states = differentiator.states(fitted)
        yield
        # At standstill a single step of the encoder is normal.
        stands = np.abs(states[1]) <= self._standing
        here = (differentiator.has_no_outlier(left) | stands).all(axis=1)
        regular = self._regular = np.append(self._regular[-1], here)
        # An outlier at the end of a window shows only in the next window.
        trusted &= regular[1:] & regular[:-1]
        trusted[:-1] &= regular[2:]
        yield
        return states, trusted
