"""The learners of this folder as torch modules, and how networks are trained."""

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from hybrid.arrays import Array
from hybrid.compensator.conditional import FARTHEST
from learners.envelope import LOG_VARIANCE, Envelope

if TYPE_CHECKING:
    from learners.network import NetworkRegression
    from learners.random_features import RandomFeatureRegression

_BATCH = 256
_RATE = 3e-3
_DECAY = 1e-4


class EnvelopedModule(torch.nn.Module):
    """A module from x to mean and variance that fades as its envelope says."""

    offset: Tensor
    scale: Tensor
    whitening: Tensor
    centre: Tensor
    prior_variance: Tensor
    bound: Tensor
    fade: Tensor

    def __init__(self, envelope: Envelope) -> None:
        super().__init__()
        for name, values in envelope.arrays().items():
            self.keep(name.removeprefix("envelope."), values)

    def keep(self, name: str, values: Array) -> None:
        """Hold an array under a name, as it is saved and moved between devices."""
        self.register_buffer(name, torch.tensor(values, dtype=torch.float64))

    def learned(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Mean [N·m] and variance [(N·m)²] at standardised inputs z, shape (N, d)."""
        raise NotImplementedError

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Mean [N·m] and variance [(N·m)²], shape (N, m), at inputs x, shape (N, d)."""
        z = torch.clamp((x - self.offset) / self.scale, -FARTHEST, FARTHEST)
        mean, variance = self.learned(z)
        w = torch.tensordot(z, self.whitening, dims=([1], [2])) - self.centre
        distance = (w * w).sum(dim=2)
        soft = -2.0 * torch.logsumexp(-0.5 * distance, dim=1, keepdim=True)
        start, end = self.fade[0], self.fade[1]
        u = torch.clamp((end - soft) / (end - start), 0.0, 1.0)
        trust = u * u * (3.0 - 2.0 * u)
        doubt = 1.0 - trust
        mean = torch.minimum(torch.maximum(mean, -self.bound), self.bound)
        variance = trust * (variance + doubt * mean**2)
        return trust * mean, variance + doubt * self.prior_variance


class NetworkModule(EnvelopedModule):
    """The numbers of a :class:`NetworkRegression`."""

    size: Tensor

    def __init__(self, model: "NetworkRegression") -> None:
        super().__init__(model.envelope)
        self.history, self.depth = model.history, len(model.layers)
        self.keep("size", model.scale)
        for k, (weight, bias) in enumerate(model.layers):
            self.keep(f"weight_{k}", weight)
            self.keep(f"bias_{k}", bias)

    def learned(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Mean [N·m] and variance [(N·m)²] at standardised inputs z, shape (N, d)."""
        layers = [
            (getattr(self, f"weight_{k}"), getattr(self, f"bias_{k}"))
            for k in range(self.depth)
        ]
        out, m = _forward(z, layers, self.history), self.size.shape[0]
        spread = torch.exp(torch.clamp(out[:, m:], *LOG_VARIANCE))
        return self.size * out[:, :m], self.size**2 * spread


class RandomFeatureModule(EnvelopedModule):
    """The numbers of a :class:`RandomFeatureRegression`."""

    directions: Tensor
    phases: Tensor
    weights: Tensor
    factor: Tensor
    noise: Tensor

    def __init__(self, model: "RandomFeatureRegression") -> None:
        super().__init__(model.envelope)
        for name, values in model.arrays().items():
            if not name.startswith("envelope."):
                self.keep(name, values)

    def learned(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Mean [N·m] and variance [(N·m)²] at standardised inputs z, shape (N, d)."""
        phi = torch.cos(z @ self.directions + self.phases)
        phi = phi * (2.0 / self.phases.shape[0]) ** 0.5
        doubt = ((phi @ self.factor) ** 2).sum(dim=1, keepdim=True)
        return phi @ self.weights, self.noise * (1.0 + doubt)


class SymmetricModule(torch.nn.Module):
    """A module and its mirror image; see ``SymmetricRegression``."""

    signs: Tensor

    def __init__(self, inner: torch.nn.Module, signs: Array, parity: float) -> None:
        super().__init__()
        self.inner, self.parity = inner, parity
        self.register_buffer("signs", torch.tensor(signs, dtype=torch.float64))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Mean [N·m] and variance [(N·m)²], shape (N, m), at inputs x, shape (N, d)."""
        mean, variance = self.inner(x)
        mirrored, spread = self.inner(x * self.signs)
        return 0.5 * (mean + self.parity * mirrored), 0.5 * (variance + spread)


def _forward(z: Tensor, layers: list[tuple[Tensor, Tensor]], history: int) -> Tensor:
    x = z.reshape(z.shape[0], history, -1)
    for weight, bias in layers[:-1]:
        x = torch.tanh(x.reshape(z.shape[0], -1, weight.shape[0]) @ weight + bias)
    weight, bias = layers[-1]
    return x.reshape(z.shape[0], -1) @ weight + bias


def train(
    z: Array,
    y: Array,
    sizes: list[tuple[int, int]],
    history: int,
    *,
    epochs: int,
    rng: np.random.Generator,
) -> tuple[tuple[Array, Array], ...]:
    """Layers that make standardised outputs likely.

    Args:
        z: Standardised inputs, shape (N, d).
        y: Standardised outputs, shape (N, m).
        sizes: Inputs and outputs of each layer.
        history: Samples in one input row.
        epochs: Passes over the data.
        rng: Source of the start and of the order of samples.
    """
    inputs, targets = (torch.tensor(x, dtype=torch.float32) for x in (z, y))
    layers = []
    for before, after in sizes:
        start = rng.normal(size=(before, after)) / np.sqrt(before)
        weight = torch.tensor(start, dtype=torch.float32, requires_grad=True)
        layers.append((weight, torch.zeros(after, requires_grad=True)))
    flat = [x for pair in layers for x in pair]
    optimiser = torch.optim.AdamW(flat, lr=_RATE, weight_decay=_DECAY)
    steps = epochs * -(-len(z) // _BATCH)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    m = y.shape[1]
    for _ in range(epochs):
        order = torch.from_numpy(rng.permutation(len(z)))
        for rows in torch.tensor_split(order, -(-len(z) // _BATCH)):
            out = _forward(inputs[rows], layers, history)
            log = torch.clamp(out[:, m:], *LOG_VARIANCE)
            loss = (log + (targets[rows] - out[:, :m]) ** 2 * torch.exp(-log)).mean()
            optimiser.zero_grad()
            torch.autograd.backward(loss)
            torch.nn.utils.clip_grad_norm_(flat, 1.0)
            optimiser.step()
            falling.step()
    return tuple(
        (w.detach().double().numpy(), b.detach().double().numpy()) for w, b in layers
    )
