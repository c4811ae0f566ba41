"""Choose the cut-off between motion and noise from the spectrum of positions."""

import numpy as np

from hybrid.arrays import Array
from hybrid.recording.recording import Recording

NOISE_BAND = (0.3, 0.45)  # of the rate: frequencies at which an arm does not move


def choose_cutoff(recording: Recording) -> float:
    """Choose the cut-off above which positions hold more noise than motion.

    The noise floor of a joint is the median of its position spectrum between 0.3 and
    0.45 of the rate (segments of 4 s, Blackman-Harris window). Its motion ends at the
    lowest frequency where the spectrum is less than 30 times (15 dB) this floor. The
    cut-off is 1.5 times the median of these frequencies over the joints that move.

    Args:
        recording: Joint log on a uniform clock.

    Returns:
        Cut-off between 5 Hz and 0.4 of the rate, [Hz].
    """
    rate = recording.rate
    q = recording.q[:, np.ptp(recording.q, axis=0) > 0]
    highest = 0.4 * rate
    if q.size == 0 or len(q) < 16 or highest <= 5.0:
        return float(highest)
    size = min(len(q), int(4 * rate))
    f, power = np.fft.rfftfreq(size, 1 / rate), power_spectrum(q, size)
    in_band = (f > NOISE_BAND[0] * rate) & (f < NOISE_BAND[1] * rate)
    noise = np.median(power[in_band], axis=0)
    # A simulated log has no noise; the floor is then 1e-14 of the peak.
    above = power > 30 * np.maximum(noise, 1e-14 * power.max(axis=0))
    # The majority of the bins within 2 Hz decides, because single bins scatter.
    width = max(1, int(np.searchsorted(f, 2.0)))
    window = np.ones(width) / width
    share = np.apply_along_axis(np.convolve, 0, above, window, mode="same")
    ended = (share < 0.5) & (f > 0.5)[:, None]
    ends = np.where(ended.any(axis=0), f[np.argmax(ended, axis=0)], highest)
    return float(np.clip(1.5 * np.median(ends), 5.0, highest))


def power_spectrum(x: Array, size: int) -> Array:
    """Power spectrum of signals (N, n), shape (size//2 + 1, n), in any unit.

    It is the mean over half-overlapping segments without their linear trends. Leakage
    of the window is below 1e-9 of the power.
    """
    from scipy.signal import welch

    _, power = welch(  # type: ignore[call-overload]  # the stub has no "linear"
        x, 1.0, "blackmanharris", size, size // 2, detrend="linear", axis=0
    )
    return np.asarray(power)
