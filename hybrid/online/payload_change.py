"""Detect that the last link has taken or lost a payload.

Source: Willsky and Jones 1976, doi 10.1109/TAC.1976.1101146 (generalised likelihood
ratio of a jump, here with fading memory).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat

import numpy as np
from scipy.linalg import lapack

from hybrid.arrays import Array
from hybrid.online.layout import PAYLOAD

_THRESHOLD = 50.0
_HOLD = 1.0  # s after a change in which none is looked for
_LEARNING = 10.0  # s at first in which none is looked for


@dataclass(frozen=True)
class Change:
    """A payload grasped or dropped; which, and its mass, the next samples tell.

    Attributes:
        t: When it was noticed, [s].
        statistic: Likelihood-ratio statistic, about χ² with 4 degrees of freedom while
            nothing changes.
    """

    t: float
    statistic: float


def likely_payload(
    change: Array, covariance: Array, directions: Array, sizes: Array
) -> Array:
    """The likeliest payload behind a change of all unknowns, shape (10,).

    Args:
        change: Change of the unknowns, shape (d,).
        covariance: Its covariance, shape (d, d).
        directions: Change by usual payload parameters, shape (d, 10).
        sizes: Those usual parameters, shape (10,).
    """
    used = np.any(directions != 0, axis=1)
    D = directions[used]
    whole = covariance[np.ix_(used, used)] + D @ D.T
    return np.asarray(sizes * (D.T @ np.linalg.solve(whole, change[used])))


class PayloadChange:
    """Fading sums of what torque errors say about mass and first moments held.

    Args:
        memories: Time constants of the sums, [s]: short for heavy, long for light.
        rate: Updates per second, [Hz].
        mass: Usual payload, [kg].
        reach: Usual distance of its centre from the last joint, [m].
    """

    def __init__(
        self,
        *,
        rate: float,
        mass: float,
        reach: float,
        memories: tuple[float, ...] = (0.1, 0.4),
    ) -> None:
        self._fade = np.exp(-1.0 / (rate * np.array(memories)))
        usual = np.array([mass, *3 * [mass * reach]])
        self._prior = np.diag(1.0 / usual**2)
        # Information of the derivatives, with their products with the errors behind.
        self._sums = np.zeros((len(memories), PAYLOAD, PAYLOAD + 1))
        self._quiet_until: float | None = None

    def hear(self, J: Array, error: Array) -> None:
        """Take in one sample.

        Args:
            J: Torque per unit of the last link's mass and first moments, over its
                standard deviation, shape (m, 4).
            error: Torque less its prediction over that, shape (m,).
        """
        self._sums *= self._fade[:, None, None]
        self._sums[:, :, :PAYLOAD] += J.T @ J
        self._sums[:, :, PAYLOAD] += J.T @ error

    def noticed(self, t: float, repeats: float) -> float | None:
        """Judge what was heard.

        Args:
            t: Time, [s].
            repeats: Successive errors that tell as much as one independent one.

        Returns:
            The statistic of a change, when one is noticed.
        """
        if self._quiet_until is None:
            self._quiet_until = t + _LEARNING
        largest = max(map(self._statistic, self._sums, self._fade, repeat(repeats)))
        if largest < _THRESHOLD or t < self._quiet_until:
            return None
        self._sums[:] = 0.0
        self._quiet_until = t + _HOLD
        return largest

    def _statistic(self, sums: Array, fade: float, repeats: float) -> float:
        """Likelihood ratio of a jump, by the sums of one memory."""
        # What a sum holds counts as one independent error at least.
        share = 1.0 / min(repeats, 1.0 / (1.0 - fade))
        score = share * sums[:, PAYLOAD]
        _, jump, _ = lapack.dposv(share * sums[:, :PAYLOAD] + self._prior, score)
        # The variance of a sum with fading weights is 1/(1 + fade) of its information.
        return float((1.0 + fade) * (jump @ score))
