"""Irregular clock -> uniform clock."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording.recording import Recording, row_words

JITTER = 0.01  # of a step: what stays is below the error of a central difference
GAP = 10  # steps: a longer hole cannot be filled without inventing motion


def resample(recording: Recording) -> Recording:
    """Put a recording on a uniform clock at its median rate.

    Positions are interpolated by PCHIP, which keeps speed continuous and does not
    overshoot, the other channels linearly. A clock that keeps its step within 1 % is
    left as it is.

    Args:
        recording: Joint log on any increasing clock.

    Returns:
        The same recording if its clock is uniform, else a resampled one.

    Raises:
        RecordingError: Time jumps by more than 10 steps.

    Warns:
        HybridWarning: The clock was irregular; says how much.
    """
    steps = np.diff(recording.t)
    step = float(np.median(steps))
    off = np.abs(steps - step) / step
    if np.max(off) <= JITTER:
        return recording
    gap = int(np.argmax(steps))
    if steps[gap] > GAP * step:
        raise RecordingError(
            f"{recording.source or 'recording'}: t, {row_words(gap + 1)}: "
            f"{steps[gap]:.6g} s after the row before, with a step of {step:.6g} s; "
            f"valid are gaps up to {GAP} steps: split the recording there"
        )
    from scipy.interpolate import PchipInterpolator

    count = int(np.floor(recording.duration / step * (1 + 1e-12))) + 1
    t = recording.t[0] + step * np.arange(count)
    channels = {
        name: np.stack([np.interp(t, recording.t, x) for x in values.T], axis=1)
        for name, values in recording.channels.items()
        if name != "q"
    }
    within = np.minimum(t, recording.t[-1])
    channels["q"] = PchipInterpolator(recording.t, recording.q, axis=0)(within)
    uneven = int(np.sum(off > JITTER))
    warnings.warn(
        f"{recording.source or 'recording'}: irregular clock: {uneven} of "
        f"{len(steps)} steps differ from the median {step:.6g} s by more than "
        f"{JITTER:.0%} (at most {np.max(off):.0%}); resampled to {count} samples at "
        f"{1 / step:.6g} Hz",
        HybridWarning,
        stacklevel=2,
    )
    return replace(recording, t=t, **channels)  # type: ignore[arg-type]
