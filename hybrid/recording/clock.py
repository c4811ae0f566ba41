"""Resample a recording with an irregular clock; split one with gaps."""

from dataclasses import replace

import numpy as np

from hybrid.errors import RecordingError, warn
from hybrid.recording.recording import Recording, row_words
from hybrid.shown import counted

JITTER = 0.01  # of a step; less is below the error of a central difference
GAP = 10  # steps; a longer gap is not interpolated
PART = 1.0  # s, shortest useful part between two gaps


def resample(recording: Recording) -> Recording:
    """Resample a recording to a uniform clock at its median rate.

    Positions are interpolated by PCHIP, which keeps speed continuous and does not
    overshoot; the other channels are interpolated linearly. A clock whose steps differ
    by less than 1 % is not changed.

    Raises:
        RecordingError: Time jumps by more than 10 steps.

    Warns:
        HybridWarning: The clock was irregular; the message says how much.
    """
    steps = np.diff(recording.t)
    step = float(np.median(steps))
    error = np.abs(steps - step) / step
    if np.max(error) <= JITTER:
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
    uneven = int(np.sum(error > JITTER))
    warn(
        f"{recording.source or 'recording'}: irregular clock: {uneven} of "
        f"{len(steps)} steps differ from the median {step:.6g} s by more than "
        f"{JITTER:.0%} (at most {np.max(error):.0%}); resampled to {count} samples at "
        f"{1 / step:.6g} Hz"
    )
    return replace(recording, t=t, **channels)  # type: ignore[arg-type]


def unbroken(recording: Recording) -> tuple[Recording, ...]:
    """Split a recording at the gaps of its clock.

    Returns:
        The parts between gaps of more than 10 steps, with their original times.
        Parts shorter than 1 s are left out. The recording itself if it has no gap, or
        if all parts are shorter.

    Warns:
        HybridWarning: It was split; the message says into how many parts, and how much
            was left out.
    """
    steps = np.diff(recording.t)
    jumps = np.flatnonzero(steps > GAP * np.median(steps)) + 1
    if not len(jumps):
        return (recording,)
    rows = np.split(np.arange(len(recording.t)), jumps)
    kept = [r for r in rows if recording.t[r[-1]] - recording.t[r[0]] >= PART]
    if not kept:
        return (recording,)
    seconds = np.ptp(recording.t) - sum(np.ptp(recording.t[r]) for r in kept)
    warn(
        f"{recording.source or 'recording'}: t, {row_words(int(jumps[0]))}: first of "
        f"{counted(len(jumps), 'gap')} of more than {GAP} steps; taken as "
        f"{counted(len(kept), 'recording')}, without {seconds:.3g} s of gaps and of "
        f"parts below {PART:g} s"
    )
    parts = []
    for r in kept:
        channels = {name: x[r] for name, x in recording.channels.items()}
        parts.append(replace(recording, t=recording.t[r], **channels))  # type: ignore[arg-type]
    return tuple(parts)
