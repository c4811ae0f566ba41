"""Update the estimate of all unknowns with the rows of a block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.online.layout import Indices, RowLayout
from hybrid.online.noise import TorqueNoise
from hybrid.online.payload_change import PayloadChange
from hybrid.online.square_root import SquareRootFilter

_SURPRISE = 5.0  # standard deviations to which an error is cut


@dataclass(frozen=True)
class _News:
    """Rows of the m joints that move, not yet taken in; of unit noise."""

    joints: Indices  # (m,)
    H: Array  # (m, d)
    error: Array  # (m,)
    payload: Array  # (m, 4): derivative by mass and first moments held
    repeats: float  # see TorqueNoise


class OnlineEstimate:
    """Filter, noise and payload detector together, a few tasks for each row.

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
        self._seen, self._spread = np.zeros((0, len(root.mean))), np.zeros(0)

    def judge(self, row: Array, layout: RowLayout) -> None:
        """Compute the errors of a row under the present estimate.

        Args:
            row: Flat row, shape (P,).
            layout: What is where in it.
        """
        J, p = layout.derivative(row), self._gains
        self.error = row[layout.torque] - J[:, :p] @ self.filter.mean[:p]
        joints = np.flatnonzero(row[layout.moving] > 0.5)
        self._news = None
        if joints.size:
            repeats = self.noise.repeats
            share = 1.0 / (self.noise.std[joints] * np.sqrt(repeats))
            payload = row[layout.payload[joints]] * share[:, None]
            H, error = J[joints] * share[:, None], self.error[joints] * share
            self._news = _News(joints, H, error, payload, repeats)

    def foresee(self, t: float) -> None:
        """Compute how large errors may be by what is not known, for the detector too.

        Args:
            t: Time, [s]; before and after a change are not to mix.
        """
        if t < self._learn_from:
            self._news = None
        news = self._news
        if news is not None:
            self._seen = self.filter.seen(news.H)
            square = np.einsum("ij,ij->i", self._seen, self._seen)
            self._spread = np.sqrt(1.0 + square)
            # At once a row counts in full; what repeats itself counts less in the sums.
            one = np.sqrt(news.repeats) / self._spread
            self._detector.hear(news.payload * one[:, None], news.error * one)

    def look(self, t: float) -> float | None:
        """Look for a payload grasped or dropped.

        After one the estimate is widened, and rows count again when they no longer mix
        before and after.

        Args:
            t: Time, [s].

        Returns:
            Statistic of the change, if one is noticed.
        """
        if self._news is None:
            return None
        change = self._detector.noticed(t, self._news.repeats)
        if change is not None:
            self.before = self.filter.mean.copy(), self.filter.covariance
            self.filter.widen(self.payload)
            self._learn_from, self._news = t + self._mixing, None
        return change

    @property
    def tasks(self) -> tuple[Callable[[], None], ...]:
        """What takes the row in, unless it told of a change; in order."""
        return self._weigh, self._learn, self._settle

    def _weigh(self) -> None:
        if self._news is not None:
            limit = _SURPRISE * self._spread
            error = np.minimum(np.maximum(self._news.error, -limit), limit)
            self.filter.weigh(self._seen, error, self._forgetting)

    def _learn(self) -> None:
        if self._news is not None:
            self.filter.narrow()

    def _settle(self) -> None:
        if self._news is not None:
            self.filter.keep_within(*self.bounds)
            news, std = self._news, self.noise.std[self._news.joints]
            error = news.error * np.sqrt(news.repeats) * std / self._spread
            self.noise.update(news.joints.tolist(), error.tolist())
