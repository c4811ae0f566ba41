"""The mixtures of several joints, worked out together.

At one instant most of the time of a mixture goes into calling NumPy; so all joints
share the calls. The formulas are those of ``GaussianMixtureRegression.predict``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.compensator.checks import check_matrix
from hybrid.compensator.conditional import FARTHEST
from hybrid.compensator.gmr import GaussianMixtureRegression

_CHUNK = 768  # samples at a time, so that a joint's components stay in the cache
_NEVER = 1e150  # whitened distance of a component that fills up a row
_LEAST = 1e-300  # of a sum that is divided by
# Squared distance at which a mixture has to have faded to be one of those that are
# worked out together: within it no exponential comes near the smallest numbers.
FARTHEST_FADE = 1000.0


@dataclass(frozen=True, eq=False)
class Mixtures:
    """P mixtures of one torque each, padded to d inputs and K components.

    Attributes:
        inputs: Column of the arm's state for each input, then that of a one, shape
            (P, d + 1); a padded one has scale infinity.
        offset: Training mean of each input, then 0, shape (P, d + 1, 1).
        scale: Training deviation of each input, then 1, shape (P, d + 1, 1).
        matrix: Whitening over √2, all first rows first, then the torque per input; the
            last column is what is added to the products, shape (P, dK + K, d + 1).
        weights: Ones, and the weight over volume of each component, shape (P, 2, K).
        bound: Largest absolute torque, shape (P, 1), [N·m].
        fade: What is subtracted from half the squared distance where the fade ends, and
            what the difference is divided by, shape (2, P, 1).
    """

    inputs: NDArray[np.intp]
    offset: Array
    scale: Array
    matrix: Array
    weights: Array
    bound: Array
    fade: Array

    @classmethod
    def of(
        cls,
        mixtures: Sequence[GaussianMixtureRegression],
        inputs: Sequence[Sequence[int]],
        size: int,
    ) -> Mixtures:
        """Stack mixtures.

        Args:
            mixtures: Mixtures with one output each.
            inputs: Columns of the arm's state that each looks at.
            size: Number of these columns; a one comes behind them.
        """
        P = len(mixtures)
        d, K = max(m.inputs for m in mixtures), max(m.components for m in mixtures)
        columns = np.full((P, d + 1), size)
        offset, scale = np.zeros((P, d + 1, 1)), np.full((P, d + 1, 1), np.inf)
        scale[:, d] = 1.0
        matrix, weights = np.zeros((P, d + 1, K, d + 1)), np.zeros((P, 2, K))
        matrix[:, :d, :, d] = _NEVER
        for p, mixture in enumerate(mixtures):
            c, k, own = mixture.conditional, mixture.components, mixture.inputs
            columns[p, :own] = inputs[p]
            offset[p, :own, 0] = mixture.input_offset
            scale[p, :own, 0] = mixture.input_scale
            matrix[p, :own, :k, :own] = c.whitening.transpose(1, 0, 2) / np.sqrt(2.0)
            matrix[p, d, :k, :own] = (c.gain @ c.whitening)[:, 0]
            matrix[p, :d, :k, d] = 0.0
            matrix[p, :own, :k, d] = -c.centre.T / np.sqrt(2.0)
            reply = c.output_mean - np.einsum("kmd,kd->km", c.gain, c.centre)
            matrix[p, d, :k, d] = reply[:, 0]
            weights[p, 0, :k] = 1.0
            weights[p, 1, :k] = np.exp(c.log_weight - c.log_weight.max())
        start, end = np.array([m.fade for m in mixtures]).T[..., None] / 2.0
        return cls(
            inputs=columns,
            offset=offset,
            scale=scale,
            matrix=matrix.reshape(P, (d + 1) * K, d + 1),
            weights=weights,
            bound=np.array([m.bound for m in mixtures]),
            fade=np.array([end, end - start]),
        )

    def predict(self, q: Array, v: Array) -> Array:
        """Mean torque of each mixture, shape (N, P), [N·m].

        Args:
            q: Positions of the arm, shape (N, n), [rad].
            v: Its speeds, shape (N, n), [rad/s].

        Raises:
            HybridError: A number is not finite.
        """
        state = np.concatenate([q, v, np.ones((len(q), 1))], axis=1)
        if len(state) <= _CHUNK:
            return self._predict(state.T).T
        out = np.empty((len(state), len(self.inputs)))
        for start in range(0, len(state), _CHUNK):
            part = slice(start, start + _CHUNK)
            out[part] = self._predict(state[part].T).T
        return out

    def _predict(self, state: Array) -> Array:
        z = state[self.inputs]  # (P, d + 1, n)
        z -= self.offset
        z /= self.scale
        if not np.vdot(z, z) < FARTHEST**2:
            check_matrix("state", state.T)
            np.clip(z, -FARTHEST, FARTHEST, out=z)
        (P, d), K = self.inputs.shape, self.weights.shape[2]
        found = (self.matrix @ z).reshape(P, d, K, state.shape[1])
        w, reply = found[:, :-1], found[:, -1]  # (P, d, K, n), (P, K, n)
        w *= w
        close = np.negative(w[:, 0])
        for r in range(1, d - 1):
            close -= w[:, r]
        np.exp(close, out=close)  # underflows only where the fade has long ended
        sums = self.weights @ close  # (P, 2, n)
        np.maximum(sums, _LEAST, out=sums)
        close *= reply
        mean: Array = (self.weights[:, 1:] @ close)[:, 0]
        mean /= sums[:, 1]
        np.minimum(np.maximum(mean, -self.bound, out=mean), self.bound, out=mean)
        u = np.log(sums[:, 0])
        end, width = self.fade
        u += end
        u /= width
        np.minimum(np.maximum(u, 0.0, out=u), 1.0, out=u)
        mean *= u
        mean *= u
        u *= -2.0
        u += 3.0
        mean *= u
        return mean
