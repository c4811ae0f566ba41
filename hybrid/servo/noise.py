"""How much an error of a replay says.

    w = 1 / (σ² τ_e + (0.03 u)² τ_u + (1 ms · q̇)² τ_q̇)

σ is the usual error of the replay that leaves least, σ²τ_e, at least the resolution of
the encoder.
u is the usual pull of the servo (command less position, a torque over its stiffness);
known laws are never exact and leave about 3 % of it, and clocks are known to a
millisecond. All last: τ samples count as one, the integrated autocorrelation within a
stretch. ρ is Cauchy's, so that a joint that runs against something does not pull the
rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.servo.stretch import Stretch

_FAR = 3.0  # usual errors, beyond which one counts less
_INEXACT = 0.03  # of a servo's pull: what the law of a drive leaves out
_CLOCK = 1e-3  # s
_SAME = 1e-6  # rad: less is rounding
_ROUNDS = 5  # of clipping


@dataclass(frozen=True, eq=False)
class Noise:
    """Errors of replays as a process.

    Attributes:
        weight: Of a squared error, shape (n,), [1/rad²].
        far: Errors beyond it count less, shape (n,), [rad].
    """

    weight: Array
    far: Array

    @classmethod
    def of(cls, errors: Sequence[Array], floor: Array, inexact: Array) -> Noise:
        """Noise as it shows in the errors of a good replay.

        Args:
            errors: What it misses of each stretch, shape (N, n) each, [rad].
            floor: Least usual error, shape (n,), [rad].
            inexact: Density of what laws and clocks leave out, shape (n,), [rad²].
        """
        most = _FAR * usual_error(np.concatenate(errors))
        memory = _memory([np.clip(x, -most, most) for x in errors])
        usual = np.maximum(most / _FAR, floor)
        return cls(1.0 / (usual**2 * memory + inexact), _FAR * usual)

    def least(self, other: Noise) -> Noise:
        """The smaller of two at each joint."""
        better = other.weight > self.weight
        weight = np.where(better, other.weight, self.weight)
        return Noise(weight, np.where(better, other.far, self.far))

    def reaching(self, usual: Array) -> Noise:
        """The same, but errors count in full as far as replays now usually miss.

        Args:
            usual: Usual error of replays, shape (n,), [rad].
        """
        return Noise(self.weight, np.maximum(self.far, _FAR * usual))

    def cost(self, errors: Array) -> Array:
        """Negative log likelihood but for a constant, of each joint, shape (n,)."""
        z = (errors / self.far) ** 2
        return np.asarray(0.5 * self.weight * self.far**2 * np.log1p(z).sum(axis=0))

    def weights(self, errors: Array) -> Array:
        """Weight of every error, shape (M, n), [1/rad²]."""
        return self.weight / (1.0 + (errors / self.far) ** 2)


def usual_error(errors: Array) -> Array:
    """RMS of errors, of which those far beyond it are clipped, shape (n,), [rad]."""
    clipped, usual = errors, np.sqrt(np.mean(errors**2, axis=0))
    for _ in range(_ROUNDS):
        clipped = np.clip(errors, -_FAR * usual, _FAR * usual)
        usual = np.sqrt(np.mean(clipped**2, axis=0))
    return np.asarray(usual)


def inexactness(stretches: Sequence[Stretch]) -> Array:
    """Density of what laws and clocks leave out: (0.03 u)² τ_u + (1 ms · q̇)² τ_q̇.

    Args:
        stretches: What is replayed.
    """
    pulled = [x.command - x.q for x in stretches]
    usual = np.concatenate(pulled).mean(axis=0)
    laws = [_INEXACT * (x - usual) for x in pulled]
    clocks = [_CLOCK * np.gradient(x.q, x.step, axis=0) for x in stretches]
    return sum(
        (np.concatenate(x).var(axis=0) * _memory(x) for x in (laws, clocks)),
        start=np.zeros(len(usual)),
    )


def _memory(errors: Sequence[Array]) -> Array:
    """Integrated autocorrelation within stretches, (n,), in samples; Sokal's window."""
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
    """Noise of positions from their steps: an encoder's, shape (n,), [rad].

    The median of the stretches that move: some may be of a clock that was resampled,
    with positions between the steps.
    """
    out = []
    for own in zip(*(x.q.T for x in stretches), strict=True):
        steps = [np.diff(np.unique(q)) for q in own]
        # Not the least: numbers that were rounded differ by less than a step.
        told = [np.quantile(x[x > _SAME], 0.1) for x in steps if (x > _SAME).any()]
        out.append(np.median(told) if told else 0.0)
    return np.asarray(np.array(out) / np.sqrt(12.0))
