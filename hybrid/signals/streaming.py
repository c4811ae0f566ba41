"""Filter a stream block by block: derivatives by time stamp, and a low-pass filter."""

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.errors import RecordingError

_ORDER = 4  # of the local polynomial
_BANDWIDTH = 2.5  # of the derivatives, in cut-offs
# Without an outlier, the residual is spread over this many samples at least: so many,
# or, in a short window, so large a share of it.
_SPREAD, _SPREAD_SHARE = 2.5, 1 / 8
STRETCH = 1.25  # largest factor of a window's length: bandwidth is still two cut-offs


class LocalPolynomial:
    """Position, speed and acceleration from a polynomial that is fitted to a window.

    The fit uses the time stamp of each sample, so that missing and early samples cause
    no error. The polynomial is evaluated at the mean time of the group of samples in
    the middle of its window. All three thus belong to the mean torque of the group.

    Source: Savitzky and Golay 1964, doi 10.1021/ac60214a047; Schafer 2011,
    doi 10.1109/MSP.2011.941097 (their bandwidth).

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency up to which signals shall pass, [Hz].
        group: Samples in a group g.

    Attributes:
        margin: Number of samples in a window before its group, and after it.
        span: Time from the first to the last sample of a window, [s].

    Raises:
        RecordingError: The rate is too low for the cut-off.
    """

    def __init__(self, rate: float, cutoff: float, group: int = 1) -> None:
        if not (rate > 0 and cutoff > 0 and _BANDWIDTH * cutoff < rate / 2):
            raise RecordingError(
                f"{rate:g} Hz; valid for a cut-off of {cutoff:g} Hz is a rate above "
                f"{2 * _BANDWIDTH * cutoff:g} Hz"
            )
        half = ((_ORDER + 1) * rate / (2 * _BANDWIDTH * cutoff) + 4.6) / 3.2
        self.margin = max(3, round(half - (group - 1) / 2))
        self._group, self._length = group, 2 * self.margin + group
        self.span = (self._length - 1) / rate
        self._even = np.linspace(-1.0, 1.0, self._length)
        self._middle = np.zeros(self._length)
        self._middle[self.margin : self.margin + group] = 1.0 / group
        self._cached = np.zeros((0, 0), dtype=np.intp)

    def windows(self, t: Array) -> tuple[Array, Mask]:
        """Powers of time in the window around each of B groups.

        Returns:
            Powers 0 to 4 of the time from the middle in half spans, shape (B, 5, W);
            and whether the window has the nominal length, shape (B,). A window of
            another length gets uniform times.
        """
        around = t[self._index(len(t))]
        s = around - (around @ self._middle)[:, None]
        s *= 2.0 / self.span
        stretch = 0.5 * (s[:, -1] - s[:, 0])
        nominal = (stretch < STRETCH) & (stretch > 1.0 / STRETCH)
        s[~nominal] = self._even
        powers = np.empty((len(s), _ORDER + 1, self._length))
        powers[:, 0] = 1.0
        for k in range(_ORDER):
            np.multiply(powers[:, k], s, out=powers[:, k + 1])
        return powers, nominal

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

    def residual(self, powers: Array, q: Array, fitted: Array) -> Array:
        """Positions less the fitted polynomials, shape (B, W, n), [rad]."""
        residual: Array = q[self._index(len(q))] - powers.transpose(0, 2, 1) @ fitted
        return residual

    def has_no_outlier(self, residual: Array) -> Mask:
        """Tell whether no single sample dominates the residual r, shape (B, n).

        A dominant sample has a wrong value or a wrong time stamp. The effective number
        of samples in the residual is (Σ r²)²/Σ r⁴; for white noise it is W/3.
        """
        square = residual * residual
        total = square.sum(axis=1)
        square *= square
        least = min(_SPREAD, self._length * _SPREAD_SHARE)
        return np.asarray(total**2 >= least * square.sum(axis=1))

    def _index(self, samples: int) -> Index:
        """Indices of the samples of each window, shape (B, W)."""
        if self._cached.size == 0 or self._cached[-1, -1] != samples - 1:
            first = np.arange(0, samples - self._length + 1, self._group)
            self._cached = first[:, None] + np.arange(self._length)
        return self._cached


class BlockLowPass:
    """Second-order Butterworth filter that returns every B-th output.

    The last output and the new state are linear in a block of B inputs and the old
    state, so that one small matrix product does B steps. The filter starts in the
    steady state of the first sample.

    Args:
        rate: Samples per second, [Hz].
        cutoff: Frequency at which the gain is 0.71, [Hz].
        block: Number of samples in a block B.
    """

    def __init__(self, rate: float, cutoff: float, block: int) -> None:
        from scipy.signal import butter

        (b0, b1, b2), (_, a1, a2) = butter(2, cutoff, fs=rate)
        self._settled = (b1 - a1) + (b2 - a2), b2 - a2
        first, second, *inputs = np.eye(2 + block)
        for x in inputs:
            y = b0 * x + first
            first, second = b1 * x - a1 * y + second, b2 * x - a2 * y
        self._step = np.array([first, second, y])  # (3, 2 + B)
        self._state: Array | None = None

    def __call__(self, x: Array) -> Array:
        """Filter a block of inputs (B, P); return the last output, shape (P,)."""
        if self._state is None:
            self._state = np.multiply.outer(np.array(self._settled), x[0])
        out = self._step @ np.concatenate([self._state, x])
        self._state = out[:2]
        return np.asarray(out[2])
