"""How networks are trained, with torch."""

import numpy as np
import torch
from torch import Tensor

from hybrid.arrays import Array
from learners.envelope import LOG_VARIANCE

_BATCH = 256
_RATE = 3e-3
_DECAY = 1e-4


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
