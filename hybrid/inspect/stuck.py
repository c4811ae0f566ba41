"""Torques that repeat a value which they do not have: frozen, or saturated."""

import numpy as np

from hybrid.arrays import Array, Mask

_LONGEST_REPEAT = 0.2  # s; quantised torque repeats for less while an arm moves
_FEWEST = 10  # samples of a frozen channel
_SHARE = 0.01  # of a log, at its extreme value: a peak is a sample or two
_COARSE = 0.1  # distinct values per sample of a torque that was quantised coarsely
_UNUSUAL = 3.0  # times the third longest run of equal values
_ALONE = 5.0  # times the samples of the next level


def stuck_torque(t: Array, q: Array, tau: Array) -> tuple[Mask, Mask]:
    """Samples at which a torque is frozen while the arm moves, and saturated, (N,).

    Args:
        t: Time, shape (N,), [s].
        q: Positions of all joints, shape (N, n), [rad].
        tau: Torque of one joint, shape (N,), [N·m].
    """
    coarse, least = len(np.unique(tau)) < _COARSE * len(t), fewest_repeats(t)
    longest = max(5 * least, _usual_run(tau)) if coarse else least
    saturated = _clipped(tau, coarse)
    return _moving(q, repeats(tau, longest)) & ~saturated, saturated


def fewest_repeats(t: Array) -> int:
    """Number of equal samples in time, shape (N,), [s], that are unusual."""
    return max(_FEWEST, round(_LONGEST_REPEAT / float(np.median(np.diff(t)))))


def stretches(flags: Mask) -> list[slice]:
    """Runs of consecutive samples whose flags are set."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [slice(*x) for x in ends.reshape(-1, 2).tolist()]


def repeats(x: Array, least: int) -> Mask:
    """Samples in runs of equal values with at least a given length."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x)) + 1, [len(x)]])
    lengths = np.diff(starts)
    return np.repeat(lengths >= least, lengths)


def _moving(q: Array, runs: Mask) -> Mask:
    """Runs during which the arm moves."""
    moved = np.any(np.diff(q, axis=0, prepend=q[:1]) != 0, axis=1)
    kept = np.zeros_like(runs)
    for run in stretches(runs):
        kept[run] = moved[run].mean() > 0.5
    return kept


def _usual_run(x: Array) -> int:
    """Length from which on a run of equal values of a coarse sensor is unusual.

    It is a multiple of the third longest run, as the sensor may have frozen twice.
    """
    lengths = np.diff(np.flatnonzero(np.diff(x)), prepend=-1)
    return int(_UNUSUAL * np.sort(lengths)[-3]) if len(lengths) > 2 else 0


def _clipped(x: Array, coarse: bool) -> Mask:
    """Samples at an extreme value that is held repeatedly.

    A coarse sensor holds every level: there the extreme one must be much more frequent.
    """
    clipped = np.zeros(len(x), dtype=bool)
    for y in (x, -x) if np.ptp(x) > 0 else ():
        at = y == y.max()
        if at.mean() > _SHARE and (at[1:] & at[:-1]).sum() > 0.5 * at.sum():
            beside = np.sum(y == y[~at].max())
            clipped |= at & (not coarse or at.sum() > _ALONE * beside)
    return clipped
