"""Measurement of the gap between logs and a simulator; its training and test set."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter1d

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.gap.faults import Faults, find_faults
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.errors import RecordingError
from hybrid.identification.preparation import (
    SLOWEST,
    STANDING,
    decimated_motion,
    motions_from_logs,
)
from hybrid.recording import Recording
from hybrid.regression.data import check_torque
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.filters import LOWER_BAND, butterworth, filter_reach, passes_all
from hybrid.statistics import robust_std

_REST = 0.7  # periods of the cut-off, reach of declared dry friction near rest
_FAR = 10.0  # standard deviations of noise, of simulated from measured torque
_BLOCK_SECONDS = 3.0
_SHORTEST_BLOCK = 0.5  # s
_MOST_FOLDS = 8
_FAR_LARGER = 10.0  # times, of mean squares
_FEWEST_MOVING = 0.05  # of all samples


def measure_gap(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    band: float = np.inf,
    correct: Callable[[Motion], Motion] | None = None,
) -> Gap:
    """Measure the gap between logs and a simulator.

    Recordings are checked logs of the real arm, or motions made from them. The cut-off
    is in [Hz], chosen from the spectrum of positions if not given; above the band of
    logged torque, [Hz], nothing is compared. Motions may be corrected; see
    :mod:`.convention`.

    Raises:
        RecordingError: A recording has no torque, or there are motions alone and no
            cut-off.
    """
    if cutoff is None and not any(isinstance(x, Recording) for x in recordings):
        raise RecordingError(
            "motions do not say how they were filtered; valid is a cut-off besides, "
            "in Hz"
        )
    logged, cutoff = motions_from_logs(recordings, cutoff)
    cutoff = min(cutoff, *(m.rate / 2 for m in logged))  # no filter lets through more
    logged = [correct(m) if correct else m for m in logged]
    check_torque(logged)
    faults = [_faults(x, m, cutoff) for x, m in zip(recordings, logged, strict=True)]
    motions = [
        decimated_motion(replace(m, mask=m.mask & ~f.posture), cutoff)
        for m, f in zip(logged, faults, strict=True)
    ]
    speeds = [np.abs(m.v[m.mask]) for m in motions if m.mask.any()]
    fastest = np.max([x.max(axis=0) for x in speeds], axis=0, initial=0.0)
    slowest = np.maximum(STANDING * fastest, SLOWEST)
    bodies = tuple(RigidBody(robot.chain, m) for m in motions)
    of_positions, cutoff = cutoff, min(cutoff, band)
    simulated, left, moving = [], [], []
    for r, (motion, body) in enumerate(zip(motions, bodies, strict=True)):
        sampler = Sampler.for_rate(motion.rate, cutoff)
        tau = simulated_torque(robot, motion, body)
        # A logger's filter is like the sampler's: torque need not pass it twice.
        known = sampler.keep if band == cutoff else sampler
        left.append(known(motion.tau) - sampler(tau))
        asked = _asked(motion, tau, cutoff)
        simulated.append(replace(motion, tau=tau, asked=asked, number=r))
        every = round(logged[r].rate / motion.rate) * sampler.factor
        usable = sampler.keep(motion.mask)[:, None] & ~faults[r].torque[::every]
        moving.append(usable & ~_standing(robot, motion, slowest, cutoff))
    fold, trajectory = _folds(motions, cutoff)
    used = np.concatenate(moving)
    used &= used.mean(axis=0) > _FEWEST_MOVING
    return Gap(
        robot, tuple(simulated), bodies, cutoff, 1.0 / logged[0].rate,
        np.concatenate(left), used, fold, trajectory,
        tuple(note for f in faults for note in f.notes), position_cutoff=of_positions,
    )  # fmt: skip


def _standing(robot: Robot, motion: Motion, slowest: Array, cutoff: float) -> Mask:
    """Decimated samples at rest, and near rest at joints with declared friction."""
    factor = Sampler.for_rate(motion.rate, cutoff).factor
    v = motion.v[::factor]
    slow = np.abs(v) <= slowest
    slow[1:] |= v[1:] * v[:-1] < 0
    reach = round(_REST / cutoff * motion.rate / factor)
    rubs = robot.dry_friction(np.full((1, robot.size), SLOWEST))[0] > 0
    slow[:, rubs] = _around(slow[:, rubs], reach)
    return slow


def _folds(motions: Sequence[Motion], cutoff: float) -> tuple[Index, Index]:
    """Fold and recording of each sample, shape (M,) each; see :class:`Gap`."""
    steps = [Sampler.for_rate(m.rate, cutoff).factor for m in motions]
    # No sample is at an edge of a block, from which the last digit might move it.
    clocks = [
        m.t[::k] - m.t[0] + 0.5 / m.rate for m, k in zip(motions, steps, strict=True)
    ]
    of = np.repeat(np.arange(len(clocks)), [len(t) for t in clocks])
    blocks = (np.concatenate(clocks) // block_seconds(motions)).astype(int)
    _, fold = np.unique(of * (blocks.max() + 1) + blocks, return_inverse=True)
    return fold % _MOST_FOLDS, of


def _asked(motion: Motion, simulated: Array, cutoff: float) -> Array:
    """Simulated torque, or the measured one where both differ much, (N, n), [N·m]."""
    # The gap contains the noise of the measured torque: columns that contain it too
    # would seem to explain the gap. So the measured torque has to be far above it, too.
    low = partial(butterworth, motion.tau - simulated, rate=motion.rate)
    slow = low(cutoff=LOWER_BAND * cutoff)
    rough = np.abs(low(cutoff=cutoff) - slow)
    usable = motion.mask | ~motion.mask.any()
    far = _FAR * robust_std(rough[usable])
    clear = np.median(np.abs(motion.tau[usable]), axis=0) > far
    return np.where(clear & (np.abs(slow) > far), motion.tau, simulated)


def _faults(recording: Recording | Motion, motion: Motion, cutoff: float) -> Faults:
    """Faults at the samples of a motion, and within reach of the filter."""
    if isinstance(recording, Motion):
        none = np.zeros(motion.tau.shape, dtype=bool)
        return Faults(none[:, 0], none, ())
    found = find_faults(recording.in_order(motion.joints))
    near = np.clip(np.searchsorted(recording.t, motion.t), 0, len(recording.t) - 1)
    both = np.column_stack([found.posture, found.torque])[near]
    if not passes_all(motion.rate, cutoff):
        reach = filter_reach(cutoff / motion.rate, tolerance=1e-3)
        both = _around(both, reach)
    return replace(found, posture=both[:, 0], torque=both[:, 1:])


def _around(flags: Mask, reach: int) -> Mask:
    """Flags, shape (M, k), widened by a number of samples to both sides."""
    return np.asarray(maximum_filter1d(flags, 2 * reach + 1, axis=0, mode="constant"))


def block_seconds(motions: Sequence[Motion]) -> float:
    """Length of a block of time, [s]: 3 s, or less so that there are eight blocks."""
    total = sum(float(m.t[-1] - m.t[0]) for m in motions)
    return float(np.clip(total / _MOST_FOLDS, _SHORTEST_BLOCK, _BLOCK_SECONDS))


def seconds(gap: Gap) -> Index:
    """Second of each sample, (M,): a block, as residuals are correlated so long."""
    return np.arange(len(gap.fold)) // max(1, round(gap.rate))


def split(gap: Gap) -> Mask:
    """Training samples, shape (M,); the others are the test set."""
    # Every fourth trajectory is for testing. Where there are fewer than four, it is
    # every fourth block of time, less a part at both ends; see :func:`unseen_samples`.
    # Another split is taken where the test set alone holds squares that are far larger
    # than all of the training set.
    part, count = gap.trajectory, gap.trajectory.max() + 1
    masks = [part % 4 != k for k in (3, 2, 1, 0)]
    if count < 4:
        part = gap.fold * count + gap.trajectory
        # Another block of each trajectory, as trajectories often end alike.
        ways = [turn * gap.trajectory + more for more in range(4) for turn in (1, 2, 0)]
        masks = [(gap.fold + way) % 4 != 3 for way in ways]
        masks = [x for x in masks if x.any() and not x.all()] or masks[:1]
    most = _unusual(gap, part)
    alone = [most[~x].max(initial=0.0) / most[x].max(initial=1e-300) for x in masks]
    chosen = 0 if alone[0] < _FAR_LARGER else int(np.argmin(alone))
    return np.asarray(masks[chosen])


def _unusual(gap: Gap, part: Index) -> Array:
    """Mean squares of a sample's part over the usual ones, at its worst joint, (M,)."""
    parts, own = np.unique(part, return_inverse=True)
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    mean = np.stack([
        squares[own == k].sum(axis=0) / np.maximum(gap.moving[own == k].sum(axis=0), 1)
        for k in range(len(parts))
    ])  # fmt: skip
    usual = np.maximum(np.median(mean, axis=0), 1e-300)
    return np.asarray((mean / usual).max(axis=1)[own])


def unseen_samples(gap: Gap, learn: Mask) -> Mask:
    """Test samples beside given training samples, shape (M,)."""
    # Whole trajectories are tested; blocks of one lose a sixth at both ends.
    if gap.trajectory.max() >= 3:
        return ~learn
    reach = round(block_seconds(gap.motions) / 6 * gap.rate)
    return np.asarray(~maximum_filter1d(learn, 2 * reach + 1, mode="constant"))
