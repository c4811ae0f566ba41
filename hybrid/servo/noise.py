"""The weight of replay errors in the likelihood.

    w = 1 / (σ² τ_e + (0.03 u)² τ_u + (1 ms · q̇)² τ_q̇)

σ is the RMS error of the best replay so far, at least the resolution of the encoder. u
is the position error of the servo, command less position: a torque over the stiffness.
Simulated laws are wrong by about 3 % of it, and clocks by a millisecond. Each of these
errors is autocorrelated: τ samples count as one, where τ is the integrated
autocorrelation within a stretch. The loss ρ is Cauchy's: a joint that hits something
unknown has little weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.servo.stretch import Stretch

_FAR = 3.0  # RMS errors: larger errors have less weight
INEXACT = 0.03  # relative error of a simulated law
_CLOCK = 1e-3  # s: error of a clock
_SAME = 1e-6  # rad: smaller differences are rounding
_ROUNDS = 5  # of clipping


@dataclass(frozen=True, eq=False)
class Noise:
    """Weights of replay errors at each joint."""

    weight: Array  # of a squared error, (n,), [1/rad²]
    far: Array  # scale of the Cauchy loss, (n,), [rad]: larger errors weigh less

    @classmethod
    def of(cls, errors: Sequence[Array], floor: Array, inexact: Array) -> Noise:
        """Estimate it from the errors of a good replay, (N, n) of each stretch, [rad].

        ``floor`` is a lower bound of the RMS error, shape (n,), [rad], and ``inexact``
        the variance times τ of the errors of laws and clocks, shape (n,), [rad²].
        """
        most = _FAR * usual_error(np.concatenate(errors))
        memory = _memory([np.clip(x, -most, most) for x in errors])
        usual = np.maximum(most / _FAR, floor)
        return cls(1.0 / (usual**2 * memory + inexact), _FAR * usual)

    def least(self, other: Noise) -> Noise:
        """The smaller noise of the two at each joint."""
        far = np.where(other.weight > self.weight, other.far, self.far)
        return Noise(np.maximum(self.weight, other.weight), far)

    def reaching(self, usual: Array) -> Noise:
        """A copy that fully weighs errors of a usual size, shape (n,), [rad]."""
        return Noise(self.weight, np.maximum(self.far, _FAR * usual))

    def cost(self, errors: Array) -> Array:
        """Negative log likelihood of each joint, up to a constant, shape (n,)."""
        z = (errors / self.far) ** 2
        return np.asarray(0.5 * self.weight * self.far**2 * np.log1p(z).sum(axis=0))

    def weights(self, errors: Array) -> Array:
        """Weight of each squared error, shape (M, n), [1/rad²]."""
        return self.weight / (1.0 + (errors / self.far) ** 2)


def usual_error(errors: Array) -> Array:
    """RMS of the errors with outliers clipped, shape (n,), [rad]."""
    clipped, usual = errors, np.sqrt(np.mean(errors**2, axis=0))
    for _ in range(_ROUNDS):
        clipped = np.clip(errors, -_FAR * usual, _FAR * usual)
        usual = np.sqrt(np.mean(clipped**2, axis=0))
    return np.asarray(usual)


def inexactness(stretches: Sequence[Stretch]) -> Array:
    """Variance times τ of the errors of laws and clocks, shape (n,), [rad²].

    (0.03 u)² τ_u + (1 ms · q̇)² τ_q̇, see the module.
    """
    pulled = [x.command - x.q for x in stretches]
    usual = np.concatenate(pulled).mean(axis=0)
    laws = [INEXACT * (x - usual) for x in pulled]
    clocks = [_CLOCK * np.gradient(x.q, x.step, axis=0) for x in stretches]
    return sum(
        (np.concatenate(x).var(axis=0) * _memory(x) for x in (laws, clocks)),
        start=np.zeros(len(usual)),
    )


def _memory(errors: Sequence[Array]) -> Array:
    """Integrated autocorrelation, (n,), in samples, by Sokal's window."""
    size = max(len(x) for x in errors)
    spectra = [np.abs(np.fft.rfft(x, 2 * size, axis=0)) ** 2 for x in errors]
    products = np.fft.irfft(sum(spectra), axis=0)[:size]
    out = np.ones(products.shape[1])
    for j in np.flatnonzero(products[0] > 0).tolist():
        tau = 1.0 + 2.0 * np.cumsum(products[1:, j] / products[0, j])
        window = np.flatnonzero(np.arange(1, size) > 5.0 * tau)
        out[j] = max(1.0, tau[window[0]] if len(window) else tau.max())
    return out


def resolution(stretches: Sequence[Stretch]) -> Array:
    """Standard deviation of the quantisation of positions, shape (n,), [rad].

    It is the median over the stretches that move. Some stretches may be resampled and
    have positions between the steps of the encoder.
    """
    out = []
    for own in zip(*(x.q.T for x in stretches), strict=True):
        steps = [np.diff(np.unique(q)) for q in own]
        # Not the smallest: rounded numbers can differ by less than a step.
        told = [np.quantile(x[x > _SAME], 0.1) for x in steps if (x > _SAME).any()]
        out.append(np.median(told) if told else 0.0)
    return np.asarray(np.array(out) / np.sqrt(12.0))
