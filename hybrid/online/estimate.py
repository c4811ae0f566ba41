"""The estimate of all unknowns, updated with one row at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.online.layout import Indices, RowLayout
from hybrid.online.noise import TorqueNoise
from hybrid.online.payload_change import PayloadChange
from hybrid.online.square_root import SquareRootFilter

_MOST_DEVIATIONS = 5.0  # standard deviations at which an error is clipped


@dataclass(frozen=True)
class _Innovation:
    """The row of the m moving joints, scaled to unit noise, before the update."""

    joints: Indices  # (m,)
    H: Array  # (m, d)
    error: Array  # (m,)
    payload: Array  # (m, 4): derivative by mass and first moments of a payload
    inflation: float  # see TorqueNoise


class OnlineEstimate:
    """Recursive filter, torque noise and payload detector together.

    Args:
        square_root: The recursive filter.
        bounds: Lower and upper bounds of the unknowns, shape (d,) each.
        gains: Number of unknowns p in which the torque is linear; shapes come after.
        payload: Change of the unknowns by usual payload parameters, shape (d, 10).
        noise: Standard deviation of the torque error.
        detector: Detector of payload changes.
        forgetting: Forgetting factor λ of each update.
        mixing: Time after a change in which filtered rows still contain samples from
            before it, [s].
    """

    def __init__(
        self,
        square_root: SquareRootFilter,
        *,
        bounds: tuple[Array, Array],
        gains: int,
        payload: Array,
        noise: TorqueNoise,
        detector: PayloadChange,
        forgetting: float,
        mixing: float,
    ) -> None:
        self.filter, self.bounds, self.payload = square_root, bounds, payload
        self.noise, self._detector = noise, detector
        self._gains, self._forgetting, self._mixing = gains, forgetting, mixing
        self.before = square_root.mean.copy(), square_root.covariance
        self.error = np.zeros(len(noise.std))
        self._learn_from = -np.inf
        self._innovation: _Innovation | None = None
        self._projected, self._error_std = (
            np.zeros((0, len(square_root.mean))),
            np.zeros(0),
        )

    def compute_errors(self, row: Array, layout: RowLayout) -> None:
        """Compute the prediction errors of a row."""
        J, p = layout.derivative(row), self._gains
        self.error = row[layout.torque] - J[:, :p] @ self.filter.mean[:p]
        joints = np.flatnonzero(row[layout.moving] > 0.5)
        self._innovation = None
        if joints.size:
            inflation = self.noise.inflation
            share = 1.0 / (self.noise.std[joints] * np.sqrt(inflation))
            payload = row[layout.payload[joints]] * share[:, None]
            H, error = J[joints] * share[:, None], self.error[joints] * share
            self._innovation = _Innovation(joints, H, error, payload, inflation)

    def predict_spread(self, t: float) -> None:
        """Compute the standard deviation of the errors, and feed the detector."""
        if t < self._learn_from:
            self._innovation = None
        innovation = self._innovation
        if innovation is not None:
            self._projected = self.filter.project(innovation.H)
            square = np.einsum("ij,ij->i", self._projected, self._projected)
            self._error_std = np.sqrt(1.0 + square)
            # The detector accounts for the correlation of successive rows itself.
            share = np.sqrt(innovation.inflation) / self._error_std
            payload = innovation.payload * share[:, None]
            self._detector.add(payload, innovation.error * share)

    def detect_change(self, t: float) -> float | None:
        """Test whether a payload was grasped or dropped.

        After a change the covariance is increased, and updates pause until rows no
        longer contain samples from before it.

        Args:
            t: Time, [s].

        Returns:
            Statistic of the change, or None.
        """
        if self._innovation is None:
            return None
        change = self._detector.detect(t, self._innovation.inflation)
        if change is not None:
            self.before = self.filter.mean.copy(), self.filter.covariance
            self.filter.add_covariance(self.payload)
            self._learn_from, self._innovation = t + self._mixing, None
        return change

    @property
    def tasks(self) -> tuple[Callable[[], None], ...]:
        """Steps of the update with the row, in order; none after a change."""
        return self._begin_update, self._finish_update, self._clip

    def _begin_update(self) -> None:
        if self._innovation is not None:
            limit = _MOST_DEVIATIONS * self._error_std
            error = np.minimum(np.maximum(self._innovation.error, -limit), limit)
            self.filter.begin_update(self._projected, error, self._forgetting)

    def _finish_update(self) -> None:
        if self._innovation is not None:
            self.filter.finish_update()

    def _clip(self) -> None:
        if self._innovation is not None:
            self.filter.clip(*self.bounds)
            innovation, std = self._innovation, self.noise.std[self._innovation.joints]
            error = (
                innovation.error * np.sqrt(innovation.inflation) * std / self._error_std
            )
            self.noise.update(innovation.joints.tolist(), error.tolist())
