"""How the gap is measured: a simulator beside logs, without what they got wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.gap.faults import Faults, find_faults
from hybrid.diagnosis.gap.gap import Gap, simulated_torque
from hybrid.dynamics import RigidBody
from hybrid.errors import RecordingError
from hybrid.identification.preparation import motions_from_logs
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.filters import butterworth, filter_reach

_STANDING = 0.01  # of the highest speed
_SLOWEST = 0.002  # rad/s or m/s; a servo at rest seems to move as fast
# Periods of the cut-off for which a filter spreads how declared dry friction passed
# rest, which is the solver's own.
_REST = 0.7
_CALM = 0.5  # of the cut-off
_FAR = 10.0  # deviations of noise: so far off, torque is what the log says
_NORMAL = 1.4826  # standard deviation over median size
_BLOCK_SECONDS = 3.0
_SHORTEST_BLOCK = 0.5
_MOST_FOLDS = 8
_FEWEST_MOVING = 0.05  # of all samples


def measure_gap(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    correct: Callable[[Motion], Motion] | None = None,
) -> Gap:
    """Compare a simulator with logs, torque by torque.

    Args:
        robot: The simulator as it stands, with the friction that its file declares.
        recordings: Logs of the real arm that were checked, or motions made from such.
        cutoff: Cut-off, [Hz]; from the spectrum if not given.
        correct: What to do to each motion first; see :mod:`.convention`.

    Raises:
        RecordingError: A recording has no torque.
    """
    motions, cutoff = motions_from_logs(recordings, cutoff)
    motions = [correct(m) for m in motions] if correct else motions
    for motion in motions:
        if not np.isfinite(motion.tau).all():
            raise RecordingError(
                f"{motion.source or 'recording'}: no torque; valid is a log of time, "
                "positions and torques"
            )
    faults = [_faults(x, m, cutoff) for x, m in zip(recordings, motions, strict=True)]
    motions = [
        replace(m, mask=m.mask & ~f.posture)
        for m, f in zip(motions, faults, strict=True)
    ]
    speeds = [np.abs(m.v[m.mask]) for m in motions if m.mask.any()]
    fastest = np.max([x.max(axis=0) for x in speeds], axis=0, initial=0.0)
    bodies = tuple(RigidBody(robot.chain, m) for m in motions)
    simulated, left, moving = [], [], []
    for r, (motion, body) in enumerate(zip(motions, bodies, strict=True)):
        sampler = Sampler.for_rate(motion.rate, cutoff)
        tau = simulated_torque(robot, motion, body)
        left.append(sampler(motion.tau - tau))
        asked = _asked(motion, tau, cutoff)
        simulated.append(replace(motion, tau=tau, asked=asked, number=r))
        v = motion.v[:: sampler.factor]
        usable = sampler.keep(motion.mask)[:, None]
        usable = usable & ~faults[r].torque[:: sampler.factor]
        slow = np.abs(v) <= np.maximum(_STANDING * fastest, _SLOWEST)
        slow[1:] |= v[1:] * v[:-1] < 0
        reach = _REST / cutoff * motion.rate / sampler.factor
        resting = robot.dry_friction(np.full((1, robot.size), _SLOWEST))[0] > 0
        slow[:, resting] = _around(slow[:, resting], round(reach))
        moving.append(~slow & usable)
    fold, trajectory = _folds(motions, cutoff)
    return Gap(
        robot, tuple(simulated), bodies, cutoff,
        np.concatenate(left), _worthwhile(np.concatenate(moving)), fold, trajectory,
        tuple(note for f in faults for note in f.notes),
    )  # fmt: skip


def _folds(
    motions: Sequence[Motion], cutoff: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Fold and recording of each sample, shape (M,): whole recordings, or blocks."""
    clocks = [m.t[:: Sampler.for_rate(m.rate, cutoff).factor] - m.t[0] for m in motions]
    of = np.repeat(np.arange(len(clocks)), [len(t) for t in clocks])
    if len(motions) >= 4:
        return of % _MOST_FOLDS, of
    blocks = (np.concatenate(clocks) // block_seconds(motions)).astype(int)
    _, fold = np.unique(of * (blocks.max() + 1) + blocks, return_inverse=True)
    return fold % _MOST_FOLDS, of


def _asked(motion: Motion, simulated: Array, cutoff: float) -> Array:
    """Torque as simulated, or as measured where that is far off, shape (N, n), [N·m].

    Noise of the measured torque is in the gap as well; a column that held it would
    seem to explain it.
    """
    if not np.isfinite(cutoff):
        return motion.tau
    low = partial(butterworth, motion.tau - simulated, rate=motion.rate)
    slow = low(cutoff=_CALM * cutoff)
    rough = np.abs(low(cutoff=cutoff) - slow)
    usable = motion.mask | ~motion.mask.any()
    far = _FAR * _NORMAL * np.median(rough[usable], axis=0)
    return np.where(np.abs(slow) > far, motion.tau, simulated)


def _faults(recording: Recording | Motion, motion: Motion, cutoff: float) -> Faults:
    """Faults on the samples of a motion, and as far as the filter carries them."""
    N, n = motion.tau.shape
    if isinstance(recording, Motion):
        return Faults(np.zeros(N, dtype=bool), np.zeros((N, n), dtype=bool), ())
    found = find_faults(recording.in_order(motion.joints))
    near = np.clip(np.searchsorted(recording.t, motion.t), 0, len(recording.t) - 1)
    both = np.column_stack([found.posture, found.torque])[near]
    reach = 0
    if np.isfinite(cutoff):
        reach = filter_reach(cutoff / motion.rate, tolerance=1e-3)
    both = _around(both, reach)
    return replace(found, posture=both[:, 0], torque=both[:, 1:])


def _around(flags: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Flags, shape (M, k), and what is within reach of them, in samples."""
    window, near = np.ones(2 * reach + 1), np.zeros_like(flags)
    for j in np.flatnonzero(flags.any(axis=0)):
        # Not mode "same": that is as long as the longer of the two.
        near[:, j] = np.convolve(flags[:, j], window)[reach : -reach or None] > 0.5
    return near


def _worthwhile(moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without the joints that hardly move or whose torque is hardly measured."""
    return np.asarray(moving & (moving.mean(axis=0) > _FEWEST_MOVING))


def block_seconds(motions: Sequence[Motion]) -> float:
    """Length of the blocks that trajectories are cut into, [s].

    Three seconds; less where that leaves fewer than eight of them.
    """
    total = sum(float(m.t[-1] - m.t[0]) for m in motions)
    return float(np.clip(total / _MOST_FOLDS, _SHORTEST_BLOCK, _BLOCK_SECONDS))
