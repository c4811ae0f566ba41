"""Gaussian-mixture regression as a torch module, for export and for training loops."""

# No postponed annotations: TorchScript reads the types of the buffers below.
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from hybrid.compensator.conditional import FARTHEST

if TYPE_CHECKING:
    from hybrid.compensator.gmr import GaussianMixtureRegression


class GmrModule(torch.nn.Module):
    """The numbers of ``GaussianMixtureRegression`` in plain tensor operations.

    Nothing branches on data, so that it can be scripted, traced and exported to ONNX.
    Infinite inputs count as far outside the data; NaN comes out as NaN.

    Attributes:
        whitening: Inverse Cholesky factors of the inputs, shape (K, d, d).
        centre: Whitened input means, shape (K, d, 1).
        gain: Torque per whitened input, shape (K, m, d), [N·m].
        output_mean: Output means, shape (K, m, 1), [N·m].
        output_variance: Variance left once x is known, shape (K, m, 1), [(N·m)²].
        log_weight: Log of weight over volume, shape (K, 1).
        input_offset: Training mean of each input, shape (d,), [unit of x].
        input_scale: Training deviation of each input, shape (d,), [unit of x].
        prior_variance: Variance far from the data, shape (m, 1), [(N·m)²].
        bound: Largest absolute output, shape (m, 1), [N·m].
        fade: Squared distances where the fade starts and ends, shape (2,).
    """

    whitening: Tensor
    centre: Tensor
    gain: Tensor
    output_mean: Tensor
    output_variance: Tensor
    log_weight: Tensor
    input_offset: Tensor
    input_scale: Tensor
    prior_variance: Tensor
    bound: Tensor
    fade: Tensor

    def __init__(self, model: "GaussianMixtureRegression") -> None:
        super().__init__()
        c = model.conditional
        buffers = {
            "whitening": c.whitening,
            "centre": c.centre[..., None],
            "gain": c.gain,
            "output_mean": c.output_mean[..., None],
            "output_variance": c.output_variance[..., None],
            "log_weight": c.log_weight[:, None],
            "input_offset": model.input_offset,
            "input_scale": model.input_scale,
            "prior_variance": model.prior_variance[:, None],
            "bound": model.bound[:, None],
            "fade": model.fade,
        }
        for name, values in buffers.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.float64))
        self.reach: float = FARTHEST

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Expected remaining torque and its variance.

        Args:
            x: Inputs, shape (N, d), [unit of the training inputs].

        Returns:
            Mean, shape (N, m), [N·m], and variance, shape (N, m), [(N·m)²].
        """
        z = (x - self.input_offset) / self.input_scale
        z = torch.clamp(z, -self.reach, self.reach)
        w = torch.matmul(self.whitening, z.transpose(0, 1)) - self.centre  # (K, d, N)
        distance = (w * w).sum(dim=1)  # (K, N)
        share = torch.softmax(self.log_weight - 0.5 * distance, dim=0).unsqueeze(1)
        outputs = self.output_mean + torch.matmul(self.gain, w)  # (K, m, N)
        mixed = (share * outputs).sum(dim=0)  # (m, N)
        mixed = torch.minimum(torch.maximum(mixed, -self.bound), self.bound)
        spread = (share * (self.output_variance + (outputs - mixed) ** 2)).sum(dim=0)

        nearest = -2.0 * torch.logsumexp(-0.5 * distance, dim=0)  # (N,)
        start, end = self.fade[0], self.fade[1]
        u = torch.clamp((end - nearest) / (end - start), 0.0, 1.0)
        trust = u * u * (3.0 - 2.0 * u)
        doubt = 1.0 - trust
        variance = trust * (spread + doubt * mixed**2) + doubt * self.prior_variance
        return (trust * mixed).transpose(0, 1), variance.transpose(0, 1)
