"""Periodic motions: Fourier series in time, and averages over periods."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording.clock import resample
from hybrid.recording.recording import Recording


@dataclass(frozen=True, eq=False)
class FourierMotion:
    """q(t) = offset + Σₖ sineₖ sin(kωt) + cosineₖ cos(kωt), with exact derivatives.

    Attributes:
        fundamental: Repetitions per second, ω / 2π, [Hz].
        offset: Mean position, shape (n,), [rad].
        sine: Amplitudes of the sines, shape (order, n), [rad].
        cosine: Amplitudes of the cosines, shape (order, n), [rad].
    """

    fundamental: float
    offset: Array
    sine: Array
    cosine: Array

    @property
    def order(self) -> int:
        """Number of harmonics."""
        return len(self.sine)

    def position(self, t: ArrayLike) -> Array:
        """Position at times ``t``, shape (N,) -> (N, n), [rad]."""
        return self.offset + self._derivative(t, 0)

    def velocity(self, t: ArrayLike) -> Array:
        """Speed at times ``t``, shape (N,) -> (N, n), [rad/s]."""
        return self._derivative(t, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """Acceleration at times ``t``, shape (N,) -> (N, n), [rad/s²]."""
        return self._derivative(t, 2)

    def _derivative(self, t: ArrayLike, order: int) -> Array:
        w = 2 * np.pi * self.fundamental * np.arange(1, self.order + 1)
        # Each derivative multiplies by w and turns the phase by a quarter.
        phase = np.multiply.outer(np.asarray(t, dtype=float), w) + order * np.pi / 2
        scale = (w**order)[:, None]
        return np.asarray(
            np.sin(phase) @ (scale * self.sine) + np.cos(phase) @ (scale * self.cosine)
        )


def fourier_fit(t: Array, q: Array, *, fundamental: float, order: int) -> FourierMotion:
    """Fit a Fourier series of known fundamental to positions by least squares.

    Derivatives of the series replace numerical ones where a motion is periodic: they
    have no edges and pass only the harmonics (Swevers et al. 1997,
    doi:10.1109/70.631234).

    Args:
        t: Time, shape (N,), [s].
        q: Position, shape (N, n), [rad].
        fundamental: Repetitions per second, [Hz].
        order: Number of harmonics.

    Raises:
        RecordingError: There are too few samples, less than one period, or harmonics
            above the Nyquist frequency.
    """
    if len(t) < 2 * order + 1 or (t[-1] - t[0]) * fundamental < 0.99:
        raise RecordingError(
            f"{len(t)} samples in {t[-1] - t[0]:.4g} s; a Fourier series of order "
            f"{order} at {fundamental:g} Hz needs {2 * order + 1} and a whole period"
        )
    nyquist = (len(t) - 1) / (t[-1] - t[0]) / 2
    if order * fundamental >= nyquist:
        raise RecordingError(
            f"harmonic {order} of {fundamental:g} Hz is above the Nyquist frequency "
            f"{nyquist:g} Hz; valid are orders below {nyquist / fundamental:.4g}"
        )
    phase = np.multiply.outer(t, 2 * np.pi * fundamental * np.arange(1, order + 1))
    basis = np.hstack([np.ones((len(t), 1)), np.sin(phase), np.cos(phase)])
    found = np.linalg.lstsq(basis, q, rcond=None)[0]
    return FourierMotion(
        fundamental=fundamental,
        offset=found[0],
        sine=found[1 : order + 1],
        cosine=found[order + 1 :],
    )


def average_periods(
    recording: Recording, fundamental: float
) -> tuple[Recording, Array]:
    """Average a periodic log over its whole periods.

    What repeats stays, noise falls with the square root of the number of periods, and
    the scatter between periods is the noise itself: no model is needed to measure it.
    Cut transients at the start of the log off before.

    Args:
        recording: Joint log; an irregular clock is made uniform first.
        fundamental: Repetitions per second, [Hz].

    Returns:
        One averaged period that starts at the first time of the log, and the standard
        deviation of one torque sample, shape (n,), [N·m].

    Raises:
        RecordingError: The log holds less than two periods, or a period less than two
            samples.

    Warns:
        HybridWarning: The clock was irregular.
    """
    recording = resample(recording)
    rate = (len(recording.t) - 1) / recording.duration
    per_period = round(rate / fundamental)
    # N samples last N steps: the step after the last one belongs to the period.
    periods = int((recording.duration + 1 / rate) * fundamental * (1 + 1e-9))
    if periods < 2 or per_period < 2:
        raise RecordingError(
            f"{recording.source or 'recording'}: {periods} whole periods of "
            f"{1 / fundamental:.6g} s with {per_period} samples each; valid are two or "
            "more of each"
        )
    t = recording.t[0] + np.arange(per_period) / (per_period * fundamental)
    repeats = {
        name: _repeats(recording.t, x, t, periods, 1 / fundamental)
        for name, x in recording.channels.items()
    }
    means = {name: x.mean(axis=0) for name, x in repeats.items()}
    variance = repeats["tau"].var(axis=0, ddof=1).mean(axis=0)
    mean = replace(recording, t=t, **means)  # type: ignore[arg-type]
    return mean, np.asarray(np.sqrt(variance))


def _repeats(clock: Array, x: Array, t: Array, periods: int, period: float) -> Array:
    """Samples of each period, shape (periods, N, n)."""
    wanted = np.add.outer(period * np.arange(periods), t).ravel()
    step = (clock[-1] - clock[0]) / (len(clock) - 1)
    nearest = np.rint((wanted - clock[0]) / step).astype(int).clip(0, len(clock) - 1)
    # Interpolation would average noise away; it is needed only between samples.
    if np.max(np.abs(clock[nearest] - wanted)) < 0.01 * step:
        values = x[nearest]
    else:
        values = np.stack([np.interp(wanted, clock, column) for column in x.T], axis=1)
    return np.asarray(values.reshape(periods, len(t), -1))
