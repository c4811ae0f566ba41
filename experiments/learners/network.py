"""A small neural network with two heads, for torque and its variance.

With a history of one sample it is a multilayer perceptron; with a longer one a temporal
convolution network, which sees a short window and keeps no state that could blow up.

Sources: Nix and Weigend 1994, doi 10.1109/ICNN.1994.374138 (variance as an output);
Bai, Kolter and Koltun 2018, arXiv 1803.01271 (temporal convolutions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.gmr_fit import check_pair, draw
from hybrid.errors import HybridError
from hybrid.extras import check_extra
from learners.envelope import LOG_VARIANCE, Envelope

_ROWS = 4096  # samples at a time
_KERNEL = 4  # samples that a convolution joins


@dataclass(frozen=True, eq=False)
class NetworkRegression:
    """Layers of tanh between standardised inputs and two linear heads.

    Attributes:
        envelope: Where it is to be believed.
        history: Samples in one input row, oldest first.
        layers: Weight and bias of each layer; a layer joins groups of neighbouring
            samples, shape (group · width in, width out) and (width out,).
        scale: Size of the outputs, shape (m,), [N·m].
    """

    envelope: Envelope
    history: int
    layers: tuple[tuple[Array, Array], ...]
    scale: Array

    @staticmethod
    def fit(
        x: ArrayLike,
        y: ArrayLike,
        *,
        history: int = 1,
        width: int = 32,
        epochs: int = 60,
        seed: int | np.random.Generator = 0,
        bound: ArrayLike | None = None,
        max_samples: int = 20_000,
    ) -> NetworkRegression:
        """Learn by the likelihood of a Gaussian with the predicted mean and variance.

        Args:
            x: Inputs, shape (N, d), any unit; with a history the channels of its oldest
                sample first.
            y: Torque that the physical terms leave, shape (N, m), [N·m].
            history: Samples in one input row: 1, or a power of 4.
            width: Width of the hidden layers.
            epochs: Passes over the data.
            seed: Seed or generator.
            bound: Largest absolute output, [N·m]; the largest of ``y`` by default.
            max_samples: Rows to learn from at most.
        """
        check_extra("torch", "learn", "Training a network")
        from learners.training import train

        rng = np.random.default_rng(seed)
        x, y = draw(*check_pair(x, y), max_samples, rng)
        if x.shape[1] % history or groups(history) is None:
            raise HybridError(
                f"history is {history} of {x.shape[1]} inputs; valid is 1, or a power "
                f"of {_KERNEL} that divides them"
            )
        envelope = Envelope.around(x, y, bound=bound, rng=rng)
        z, scale = envelope.standardised(x), np.sqrt(envelope.prior_variance)
        sizes, before = [], x.shape[1] // history
        for group in groups(history) or ():
            sizes.append((group * before, width))
            before = width
        sizes += [(width, width), (width, 2 * y.shape[1])]
        layers = train(z, y / scale, sizes, history, epochs=epochs, rng=rng)
        return NetworkRegression(envelope, history, layers, scale)

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return self.envelope.offset.size

    @property
    def outputs(self) -> int:
        """Number of outputs m."""
        return self.scale.size

    def predict(self, x: ArrayLike) -> Array:
        """Mean, shape (N, m), [N·m], as of a mixture."""
        return self.predict_distribution(x)[0]

    def predict_distribution(self, x: ArrayLike) -> tuple[Array, Array]:
        """Mean [N·m] and variance [(N·m)²], shapes (N, m)."""
        z, m = self.envelope.standardised(x), self.outputs
        mean = np.empty((len(z), m))
        variance = np.empty_like(mean)
        for start in range(0, len(z), _ROWS):
            part = slice(start, start + _ROWS)
            out = self._forward(z[part])
            spread = self.scale**2 * np.exp(np.clip(out[:, m:], *LOG_VARIANCE))
            mean[part], variance[part] = self.envelope.blended(
                z[part], self.scale * out[:, :m], spread
            )
        return mean, variance

    def _forward(self, z: Array) -> Array:
        *hidden, (weight, bias) = self.layers
        x = z.reshape(len(z), self.history, -1)
        for W, b in hidden:
            x = np.tanh(x.reshape(len(z), -1, len(W)) @ W + b)
        out: Array = x.reshape(len(z), -1) @ weight + bias
        return out

    def arrays(self) -> dict[str, Array]:
        """All that was learned, by name."""
        found = self.envelope.arrays() | {"scale": self.scale}
        found["history"] = np.array([float(self.history)])
        for k, (weight, bias) in enumerate(self.layers):
            found |= {f"weight.{k}": weight, f"bias.{k}": bias}
        return found


def groups(history: int) -> list[int] | None:
    """Samples that each layer joins; None if the history has no such layers."""
    joined = []
    while history > 1:
        if history % _KERNEL:
            return None
        joined.append(_KERNEL)
        history //= _KERNEL
    return joined or [1]
