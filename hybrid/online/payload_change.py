"""Detection of a payload grasped or dropped by the last link.

Source: Willsky and Jones 1976, doi 10.1109/TAC.1976.1101146 (generalised likelihood
ratio of a jump, here with fading memory).
"""

from dataclasses import dataclass
from itertools import repeat

import numpy as np
from scipy.linalg import lapack

from hybrid.arrays import Array
from hybrid.online.layout import PAYLOAD

_THRESHOLD = 50.0  # of the likelihood-ratio statistic
_HOLD = 1.0  # s without detection after a change
_LEARNING = 10.0  # s without detection at the start
_MEMORIES = 0.1, 0.4  # s, of the fading sums: for heavy payloads, and for light ones


@dataclass(frozen=True)
class Change:
    """A payload was grasped or dropped; the next samples show its mass.

    Attributes:
        t: Time of the detection, [s].
        statistic: Likelihood-ratio statistic; about χ² with 4 degrees of freedom if
            nothing changes.
    """

    t: float
    statistic: float


def likely_payload(
    change: Array, covariance: Array, directions: Array, sizes: Array
) -> Array:
    """The most probable payload, shape (10,), for a change of the unknowns (d,).

    Usual payload parameters are ``sizes``; they change the unknowns by ``directions``,
    shape (d, 10).
    """
    used = np.any(directions != 0, axis=1)
    D = directions[used]
    total = covariance[np.ix_(used, used)] + D @ D.T
    return np.asarray(sizes * (D.T @ np.linalg.solve(total, change[used])))


class PayloadChange:
    """Likelihood-ratio test for a jump of the mass and first moments of the last link.

    There are ``rate`` updates per second, [Hz]. Usual payloads have the ``sizes``,
    shape (4,), mass [kg] and first moments [kg·m].
    """

    def __init__(self, rate: float, sizes: Array) -> None:
        self._fade = np.exp(-1.0 / (rate * np.array(_MEMORIES)))
        self._prior = np.diag(1.0 / sizes**2)
        # Information matrix of the derivatives; in the last column their products with
        # the errors.
        self._sums = np.zeros((len(_MEMORIES), PAYLOAD, PAYLOAD + 1))
        self._ignore_until: float | None = None

    def add(self, J: Array, error: Array) -> None:
        """Add one row, over the standard deviation of its error.

        J is the torque per unit of the last link's mass and first moments, shape
        (m, 4); the prediction error has the shape (m,).
        """
        self._sums *= self._fade[:, None, None]
        self._sums[:, :, :PAYLOAD] += J.T @ J
        self._sums[:, :, PAYLOAD] += J.T @ error

    def detect(self, t: float, inflation: float) -> float | None:
        """The statistic of a change if one is detected at a time [s], else None.

        ``inflation`` successive errors count as one independent error.
        """
        if self._ignore_until is None:
            self._ignore_until = t + _LEARNING
        largest = max(map(self._statistic, self._sums, self._fade, repeat(inflation)))
        if largest < _THRESHOLD or t < self._ignore_until:
            return None
        self._sums[:] = 0.0
        self._ignore_until = t + _HOLD
        return largest

    def _statistic(self, sums: Array, fade: float, inflation: float) -> float:
        """Likelihood ratio of a jump, from the sums of one memory."""
        # A sum counts as at least one independent error.
        share = 1.0 / min(inflation, 1.0 / (1.0 - fade))
        score = share * sums[:, PAYLOAD]
        _, jump, _ = lapack.dposv(share * sums[:, :PAYLOAD] + self._prior, score)
        # The variance of a sum with fading weights is 1/(1 + fade) of its information.
        return float((1.0 + fade) * (jump @ score))
