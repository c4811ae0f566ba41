"""The estimate of all unknowns, and what rows of a block tell about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.online.layout import Layout
from hybrid.online.noise import TorqueNoise
from hybrid.online.payload_change import PayloadChange
from hybrid.online.square_root import SquareRootFilter
from hybrid.robot.chain import Array

_SURPRISE = 5.0  # standard deviations to which an error is cut


@dataclass(frozen=True)
class _News:
    """Rows of the m joints that move, not yet taken in."""

    used: NDArray[np.bool_]  # (n,)
    seen: Array  # (m, d): see SquareRootFilter
    error: Array  # (m,), N·m
    size: Array  # (m,), N·m: noise of one row
    spread: Array  # (m,): the error's standard deviation, in times of its noise


class Estimate:
    """Filter, noise and payload detector together, in three tasks for each row.

    Args:
        root: The filter.
        bounds: Lowest and highest values of the unknowns, shape (d,) each.
        gains: Unknowns p that the torque is linear in; shapes come after them.
        payload: Change of the unknowns by usual payload parameters, shape (d, 10).
        noise: Size of the torque's error.
        detector: What notices a payload.
        forgetting: λ of each update.
        mixing: Time after a change for which rows mix what was with what is, [s].
    """

    def __init__(
        self,
        root: SquareRootFilter,
        *,
        bounds: tuple[Array, Array],
        gains: int,
        payload: Array,
        noise: TorqueNoise,
        detector: PayloadChange,
        forgetting: float,
        mixing: float,
    ) -> None:
        self.filter, self.bounds, self.payload = root, bounds, payload
        self.noise, self._detector = noise, detector
        self._gains, self._forgetting, self._mixing = gains, forgetting, mixing
        self.before = root.mean.copy(), root.covariance
        self.error = np.zeros(len(noise.std))
        self._learn_from = -np.inf
        self._news: _News | None = None

    def judge(self, row: Array, layout: Layout, t: float) -> float | None:
        """See what a row says of the estimate.

        Args:
            row: Flat row, shape (P,).
            layout: What is where in it.
            t: Time, [s].

        Returns:
            Statistic of the payload change that is noticed, if one is. The estimate is
            then widened, and rows count again when they do not mix before and after.
        """
        J, p = layout.derivative(row), self._gains
        self.error = row[layout.torque] - J[:, :p] @ self.filter.mean[:p]
        used = row[layout.moving] > 0.5
        self._news = None
        if t < self._learn_from or not used.any():
            return None
        std, error, repeats = self.noise.std[used], self.error[used], self.noise.repeats
        size = std * np.sqrt(repeats)
        seen = self.filter.seen(J[used] / size[:, None])
        spread = np.sqrt(1.0 + np.einsum("ij,ij->i", seen, seen))
        one = std * spread
        last = row[layout.payload[used]] / one[:, None]
        change = self._detector.update(t, last, error / one, repeats)
        if change is None:
            self._news = _News(used, seen, error, size, spread)
            return None
        self.before = self.filter.mean.copy(), self.filter.covariance
        self.filter.widen(self.payload)
        self._learn_from = t + self._mixing
        return change

    def learn(self) -> None:
        """Take the row in, unless it told of a change."""
        if self._news is not None:
            limit = _SURPRISE * self._news.spread
            error = np.clip(self._news.error / self._news.size, -limit, limit)
            self.filter.update(self._news.seen, error, self._forgetting)

    def settle(self) -> None:
        """Keep to the bounds, and learn the noise."""
        if self._news is not None:
            self.filter.keep_within(*self.bounds)
            self.noise.update(self._news.used, self._news.error / self._news.spread)
