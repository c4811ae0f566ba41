"""Filters of a stream, a block at a time: derivatives by time stamp, and a low-pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter

from hybrid.arrays import Array
from hybrid.errors import RecordingError

_ORDER = 4  # of the local polynomial
_WIDER = 2.5  # bandwidth of the derivatives in cut-offs
# Samples of a window that hold all that is left of it, at least, and of how many one.
_HOLDERS, _ONE_OF = 2.5, 8
STRETCH = 1.25  # of a window, at most: its bandwidth is still two cut-offs


class LocalPolynomial:
    """Position, speed and acceleration from a polynomial through the samples around.

    The samples count at their own time stamps: one that is missing, or comes early,
    leaves no error behind. All three are those of one polynomial at the mean time of a
    group of samples in the middle of its window, so that they belong to each other, and
    to the mean torque of the group.

    Source: Savitzky and Golay 1964, doi 10.1021/ac60214a047; Schafer 2011,
    doi 10.1109/MSP.2011.941097 (their bandwidth).

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency up to which signals shall pass, [Hz].
        group: Samples in a group g.

    Attributes:
        margin: Samples of a window before its group, and behind it.
        span: Time from the first to the last sample of a window, [s].

    Raises:
        RecordingError: The rate is too low for the cut-off.
    """

    def __init__(self, rate: float, cutoff: float, group: int = 1) -> None:
        if not (rate > 0 and cutoff > 0 and _WIDER * cutoff < rate / 2):
            raise RecordingError(
                f"{rate:g} Hz; valid for a cut-off of {cutoff:g} Hz is a rate above "
                f"{2 * _WIDER * cutoff:g} Hz"
            )
        half = ((_ORDER + 1) * rate / (2 * _WIDER * cutoff) + 4.6) / 3.2
        self.margin = max(3, round(half - (group - 1) / 2))
        self._group, self._length = group, 2 * self.margin + group
        self.span = (self._length - 1) / rate
        self._even = np.linspace(-1.0, 1.0, self._length)
        self._middle = np.zeros(self._length)
        self._middle[self.margin : self.margin + group] = 1.0 / group
        self._known = np.zeros((0, 0), dtype=np.intp)

    def windows(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Powers of time in the window around every one of B groups.

        Returns:
            Powers 0 to 4 of the time from the middle in half spans, shape (B, 5, W);
            and whether the window is as long as it should be, shape (B,). One that is
            not is filled as if it were.
        """
        around = t[self._index(len(t))]
        s = around - (around @ self._middle)[:, None]
        s *= 2.0 / self.span
        stretch = 0.5 * (s[:, -1] - s[:, 0])
        whole = (stretch < STRETCH) & (stretch > 1.0 / STRETCH)
        s[~whole] = self._even
        powers = np.empty((len(s), _ORDER + 1, self._length))
        powers[:, 0] = 1.0
        for k in range(_ORDER):
            np.multiply(powers[:, k], s, out=powers[:, k + 1])
        return powers, whole

    def moments(self, powers: Array, q: Array) -> tuple[Array, Array]:
        """Products of the powers with each other, (B, 5, 5), and with q, (B, 5, n)."""
        return powers @ powers.transpose(0, 2, 1), powers @ q[self._index(len(q))]

    def fit(self, moments: tuple[Array, Array]) -> Array:
        """Coefficients of the polynomials in half spans, shape (B, 5, n)."""
        return np.asarray(np.linalg.solve(*moments))

    def states(self, fitted: Array) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration at the mean time of every group, (B, n)."""
        per_second = 2.0 / self.span
        return (
            fitted[:, 0],
            fitted[:, 1] * per_second,
            fitted[:, 2] * (2.0 * per_second**2),
        )

    def left(self, powers: Array, q: Array, fitted: Array) -> Array:
        """What the polynomials leave of the positions, shape (B, W, n), [rad]."""
        found: Array = q[self._index(len(q))] - powers.transpose(0, 2, 1) @ fitted
        return found

    def is_spread(self, left: Array) -> NDArray[np.bool_]:
        """Whether what is left is spread over the window, for every joint, (B, n).

        If one or two samples hold it, they are wrong, or have the stamps of others. The
        number that do is (Σ r²)²/Σ r⁴; of white noise it is a third of all.
        """
        square = left * left
        total = square.sum(axis=1)
        square *= square
        holders = min(_HOLDERS, self._length / _ONE_OF)
        return np.asarray(total**2 >= holders * square.sum(axis=1))

    def _index(self, samples: int) -> NDArray[np.intp]:
        """Samples of every window, shape (B, W)."""
        if self._known.size == 0 or self._known[-1, -1] != samples - 1:
            first = np.arange(0, samples - self._length + 1, self._group)
            self._known = first[:, None] + np.arange(self._length)
        return self._known


class BlockLowPass:
    """Second-order Butterworth filter of which every B-th output is wanted.

    A block of B inputs, the state before it, the state after it and the last output are
    linear in each other, so that one small product does the work of B steps. The filter
    starts settled on the first sample.

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency at which 71 % of the amplitude is left, [Hz].
        block: Samples in a block B.
    """

    def __init__(self, rate: float, cutoff: float, block: int) -> None:
        (b0, b1, b2), (_, a1, a2) = butter(2, cutoff, fs=rate)
        self._settled = (b1 - a1) + (b2 - a2), b2 - a2
        first, second, *inputs = np.eye(2 + block)
        for x in inputs:
            y = b0 * x + first
            first, second = b1 * x - a1 * y + second, b2 * x - a2 * y
        self._step = np.array([first, second, y])  # (3, 2 + B)
        self._state: Array | None = None

    def __call__(self, x: Array) -> Array:
        """The last output, shape (P,), of a block of inputs, shape (B, P)."""
        if self._state is None:
            self._state = np.multiply.outer(np.array(self._settled), x[0])
        out = self._step @ np.concatenate([self._state, x])
        self._state = out[:2]
        return np.asarray(out[2])
