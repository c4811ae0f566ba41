"""The learners of this folder as torch modules."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from hybrid.arrays import Array
from hybrid.compensator.modules import EnvelopedModule

if TYPE_CHECKING:
    from learners.random_features import RandomFeatureRegression


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
