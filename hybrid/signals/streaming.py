"""Filters that work sample by sample: derivatives of known delay, and a low-pass."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, savgol_coeffs

from hybrid.errors import RecordingError
from hybrid.robot.chain import Array

_ORDER = 4  # of the local polynomial
_WIDER = 2.5  # bandwidth of the derivatives in cut-offs


class StreamingDerivative:
    """Position, speed and acceleration from a polynomial through the last samples.

    All three are those of one polynomial at the middle of its window, so that they
    belong to each other exactly, ``delay`` samples late. What shall be in time with
    them goes through the same delay.

    Source: Savitzky and Golay 1964, doi 10.1021/ac60214a047; Schafer 2011,
    doi 10.1109/MSP.2011.941097 (their bandwidth).

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency up to which signals shall pass, [Hz].
        size: Number of joints n.

    Raises:
        RecordingError: The rate is too low for the cut-off.
    """

    def __init__(self, rate: float, cutoff: float, size: int) -> None:
        half = ((_ORDER + 1) * rate / (2 * _WIDER * cutoff) + 4.6) / 3.2
        self.delay = max(3, round(half))
        if not (rate > 0 and cutoff > 0 and _WIDER * cutoff < rate / 2):
            raise RecordingError(
                f"{rate:g} Hz; valid for a cut-off of {cutoff:g} Hz is a rate above "
                f"{2 * _WIDER * cutoff:g} Hz"
            )
        length = 2 * self.delay + 1
        weights = [
            savgol_coeffs(length, _ORDER, deriv=k, delta=1 / rate, use="dot")
            for k in range(3)
        ]
        self._weights = np.array(weights)
        # Written twice, so that the window is always one piece.
        self._q = np.zeros((2 * length, size))
        self._other = np.zeros((2 * length, size))
        self._count = 0

    def push(self, q: Array, other: Array) -> tuple[Array, Array, Array, Array] | None:
        """Take one sample in.

        Args:
            q: Position, shape (n,), [rad].
            other: A signal to be delayed alike, such as torque, shape (n,).

        Returns:
            Position, speed, acceleration and the other signal, shape (n,) each,
            ``delay`` samples ago; None until the window is full.
        """
        length = self._weights.shape[1]
        at = self._count % length
        self._q[at] = self._q[at + length] = q
        self._other[at] = self._other[at + length] = other
        self._count += 1
        if self._count < length:
            return None
        window = self._q[at + 1 : at + 1 + length]
        position, speed, acceleration = self._weights @ window
        late = self._other[at + 1 + self.delay].copy()
        return position, speed, acceleration, late


class StreamingLowPass:
    """Second-order Butterworth filter of an array, one step at a time.

    It starts settled on the first sample.

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency at which 71 % of the amplitude is left, [Hz].
    """

    def __init__(self, rate: float, cutoff: float) -> None:
        self._b, self._a = butter(2, cutoff, fs=rate)
        self._state: tuple[Array, Array] | None = None

    def __call__(self, x: Array) -> Array:
        """The filtered array, of the shape of ``x``."""
        (b0, b1, b2), (_, a1, a2) = self._b, self._a
        if self._state is None:
            second = (b2 - a2) * x
            self._state = (b1 - a1) * x + second, second
        first, second = self._state
        y = b0 * x + first
        self._state = b1 * x - a1 * y + second, b2 * x - a2 * y
        return np.asarray(y)
