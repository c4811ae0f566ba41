"""The estimate of all unknowns, updated with one row at a time."""

from collections.abc import Generator

import numpy as np

from hybrid.arrays import Array
from hybrid.online.initial_estimate import InitialEstimate, payload_sizes
from hybrid.online.layout import MOVING, PAYLOAD, TORQUE, RowLayout
from hybrid.online.noise import TorqueNoise
from hybrid.online.payload_change import PayloadChange, likely_payload
from hybrid.online.square_root import SquareRootFilter

_PAYLOAD = 3.0  # kg, usual mass of a payload
_MOST_DEVIATIONS = 5.0  # standard deviations at which an error is clipped


class OnlineEstimate:
    """Recursive filter, torque noise and payload detector together.

    It has ``rate`` updates per second, [Hz], with the factor λ of ``forgetting`` each.
    ``noise`` is the initial standard deviation of the torque error, shape (n,), [N·m].
    For the time ``mixing``, [s], after a change filtered rows still contain samples
    from before it.
    """

    def __init__(
        self,
        start: InitialEstimate,
        layout: RowLayout,
        *,
        rate: float,
        noise: Array,
        forgetting: float,
        mixing: float,
    ) -> None:
        self.filter = SquareRootFilter(start.theta, start.root)
        self.bounds, self._gains = start.bounds(), start.problem.size
        self._sizes = payload_sizes(_PAYLOAD)
        self._payload = start.payload_directions(self._sizes)
        self.noise, self._layout = TorqueNoise(noise, rate), layout
        self._detector = PayloadChange(rate, self._sizes[:PAYLOAD])
        self._forgetting, self._mixing = forgetting, mixing
        self._before = self.filter.mean.copy(), self.filter.covariance
        self.error = np.zeros(len(noise))
        self._learn_from = -np.inf

    @property
    def taken(self) -> Array:
        """The most probable payload of the last change, shape (10,)."""
        mean, covariance = self._before
        change, both = self.filter.mean - mean, covariance + self.filter.covariance
        return likely_payload(change, both, self._payload, self._sizes)

    def learn(self, row: Array, t: float) -> Generator[None, None, float | None]:
        """Update with a row, in steps.

        After a payload was grasped or dropped the covariance is increased, and updates
        pause until rows no longer contain samples from before it.

        Returns:
            Statistic of a change of the payload, or None.
        """
        layout, p = self._layout, self._gains
        J = row[:, : layout.size]
        self.error = row[:, TORQUE] - J[:, :p] @ self.filter.mean[:p]
        joints = np.flatnonzero(row[:, MOVING] > 0.5)
        yield
        if not joints.size or t < self._learn_from:
            return None
        # The moving joints, scaled to unit noise.
        inflation, noise = self.noise.inflation, self.noise.std[joints]
        share = 1.0 / (noise * np.sqrt(inflation))
        H, error = J[joints] * share[:, None], self.error[joints] * share
        projected = H @ self.filter.root
        std = np.sqrt(1.0 + np.einsum("ij,ij->i", projected, projected))
        # The detector accounts for the correlation of successive rows itself.
        unit = np.sqrt(inflation) / std
        payload = row[joints, layout.payload] * share[:, None] * unit[:, None]
        self._detector.add(payload, error * unit)
        yield
        change = self._detector.detect(t, inflation)
        if change is not None:
            self._before = self.filter.mean.copy(), self.filter.covariance
            self.filter.add_covariance(self._payload)
            self._learn_from = t + self._mixing
            return change
        yield
        limit = _MOST_DEVIATIONS * std
        clipped = np.minimum(np.maximum(error, -limit), limit)
        yield from self.filter.update(projected, clipped, self._forgetting)
        self.filter.clip(*self.bounds)
        left = error * np.sqrt(inflation) * noise / std
        self.noise.update(joints.tolist(), left.tolist())
        yield
        return None
