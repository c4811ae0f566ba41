"""What a fit works on: motions, folds, filter and standstill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import IdentificationError, RecordingError
from hybrid.identify.cross_products import (
    CrossProducts,
    accumulate,
    moving_samples,
    sampled_chunks,
)
from hybrid.identify.model import DynamicModel
from hybrid.identify.problem import Problem
from hybrid.inspect import check_recordings
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler, choose_cutoff, motion_from_recording

_POSITION_CUTOFF = 2.0  # of the cut-off of columns and torque
_STANDING = 0.01  # of the highest speed
FOLDS = 4
_BLOCK_SECONDS = 1.0
FEWEST_PERIODS = 3.0  # of the cut-off in a recording: its edges take 2.3 of them


@dataclass(frozen=True)
class Data:
    """Motions prepared for fitting.

    Attributes:
        motions: Motions at full rate.
        folds: Fold of every sample for cross-validation, shape (N,) for each motion.
        cutoff: Cut-off of the filter of columns and torque, [Hz].
        standing: Speed of each joint below which it stands, shape (n,), [rad/s].

    Raises:
        RecordingError: A motion comes without torque.
    """

    motions: tuple[Motion, ...]
    folds: tuple[NDArray[np.intp], ...]
    cutoff: float
    standing: Array

    def __post_init__(self) -> None:
        for motion in self.motions:
            if not np.isfinite(motion.tau).all():
                raise RecordingError(
                    f"{motion.source or 'recording'}: no torque; valid is a log of "
                    "time, positions and torques"
                )

    def products(
        self, problem: Problem, known: Sequence[Array] | None = None
    ) -> CrossProducts:
        """Cross-products of a problem on these motions; see :func:`accumulate`."""
        return accumulate(
            problem,
            self.motions,
            cutoff=self.cutoff,
            standing=self.standing,
            folds=self.folds,
            known=known,
        )

    def split(self, samples: NDArray[Any]) -> list[NDArray[Any]]:
        """Decimated samples of all motions, stacked, apart again."""
        sizes = [
            -(-len(m.t) // Sampler.for_rate(m.rate, self.cutoff).factor)
            for m in self.motions
        ]
        return np.split(samples, np.cumsum(sizes)[:-1])

    def rest(self, predicted: Sequence[Array]) -> Rest:
        """What predictions leave of the torque, filtered, decimated and stacked.

        Args:
            predicted: Torque at full rate, shape (N, n) for each motion, [N·m].
        """
        parts = []
        for motion, tau, fold in zip(self.motions, predicted, self.folds, strict=True):
            sampler = Sampler.for_rate(motion.rate, self.cutoff)
            moving = moving_samples(motion, sampler, self.standing)
            q, v = motion.q[:: sampler.factor], motion.v[:: sampler.factor]
            left = sampler(motion.tau - tau)
            parts.append((q, v, left, moving, fold[:: sampler.factor]))
        return Rest(*(np.concatenate(x) for x in zip(*parts, strict=True)))

    def rest_of_folds(self, problem: Problem, theta: Array) -> Rest:
        """What solutions leave on the fold that each was not fitted on.

        Args:
            problem: The linear problem.
            theta: A solution without each fold, shape (F, p).
        """
        parts = []
        for motion, fold in zip(self.motions, self.folds, strict=True):
            sampler = Sampler.for_rate(motion.rate, self.cutoff)
            own = fold[:: sampler.factor]
            left = np.empty((len(own), problem.chain.size))
            for first, D in sampled_chunks(problem.rows, motion, sampler):
                here = slice(first, first + D.shape[1])
                left[here] = _left_over(problem, D, theta[own[here]])
            moving = moving_samples(motion, sampler, self.standing)
            q, v = motion.q[:: sampler.factor], motion.v[:: sampler.factor]
            parts.append((q, v, left, moving, own))
        return Rest(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _left_over(problem: Problem, D: Array, theta: Array) -> Array:
    """Torque less columns times a solution of its own at each sample, (M, n)."""
    left = np.empty((D.shape[1], problem.chain.size))
    for i, support in enumerate(problem.support):
        rows = D[problem.offsets[i] : problem.offsets[i + 1]]
        left[:, i] = rows[-1] - np.einsum("km,mk->m", rows[:-1], theta[:, support])
    return left


@dataclass(frozen=True)
class Rest:
    """Torque that a model leaves, M decimated samples of all motions.

    Attributes:
        q: Positions, shape (M, n), [rad].
        v: Speeds, shape (M, n), [rad/s].
        tau: Torque left, shape (M, n), [N·m].
        moving: True where a joint moves and the mask allows, shape (M, n).
        fold: Fold of each sample, shape (M,).
    """

    q: Array
    v: Array
    tau: Array
    moving: NDArray[np.bool_]
    fold: NDArray[np.intp]

    def squares(self, joint: int, predicted: Array | float) -> Array:
        """Sum of squares of a joint on each fold less some torque, shape (F,)."""
        left = np.where(self.moving[:, joint], self.tau[:, joint] - predicted, 0.0)
        return np.asarray(np.bincount(self.fold, weights=left**2), dtype=np.float64)

    def rms(self) -> Array:
        """RMS of each joint over its moving samples, shape (n,), [N·m]."""
        squares = np.where(self.moving, self.tau**2, 0.0).sum(axis=0)
        return np.asarray(np.sqrt(squares / np.maximum(self.moving.sum(axis=0), 1)))


def helps(before: Array, after: Array, worth: float) -> bool:
    """Whether squares fall on every fold, and as a whole by some share.

    Args:
        before: Squares on each fold, shape (F,).
        after: Squares on each fold with the new term, shape (F,).
        worth: Least relative fall of their sum.
    """
    return bool(np.all(after < before) and after.sum() < (1 - worth) * before.sum())


def prepare_motions(
    robot: Robot, recordings: Sequence[Recording | Motion], cutoff: float | None
) -> tuple[list[Motion], float]:
    """Check, filter and differentiate recordings; motions pass as they are.

    Args:
        robot: The arm.
        recordings: Logs of it, or motions made from such.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.

    Returns:
        Motions at full rate and the cut-off.

    Raises:
        IdentificationError: There is no recording, or the cut-off is too low for the
            shortest.
        RecordingError: A recording does not fit the arm.
    """
    if not recordings:
        raise IdentificationError("no recording given; at least one is needed")
    return motions_of(taken(robot, recordings), cutoff)


def taken(
    robot: Robot, recordings: Sequence[Recording | Motion]
) -> list[Recording | Motion]:
    """Logs as every verb takes them, see :func:`check_recordings`; motions as are."""
    logs: list[Recording | Motion] = []
    for x in recordings:
        logs += check_recordings([x], robot) if isinstance(x, Recording) else [x]
    return logs


def motions_of(
    logs: Sequence[Recording | Motion], cutoff: float | None
) -> tuple[list[Motion], float]:
    """Filter and differentiate logs that were checked; see :func:`prepare_motions`."""
    if cutoff is None:
        chosen = [choose_cutoff(x) for x in logs if isinstance(x, Recording)]
        cutoff = float(np.median(chosen)) if chosen else np.inf
    shortest = min(float(x.t[-1] - x.t[0]) for x in logs)
    if not cutoff * shortest >= FEWEST_PERIODS:
        raise IdentificationError(
            f"cutoff is {cutoff:g} Hz; valid is {FEWEST_PERIODS / shortest:.3g} Hz or "
            f"more for a recording of {shortest:.3g} s"
        )
    motions = [
        motion_from_recording(x, cutoff=_POSITION_CUTOFF * cutoff)
        if isinstance(x, Recording)
        else x
        for x in logs
    ]
    return motions, cutoff


def prepare(
    robot: Robot, recordings: Sequence[Recording | Motion], cutoff: float | None
) -> Data:
    """Motions dealt into folds, each of which scores what the others fitted.

    Whole recordings make the folds when there are four or more, else blocks of a
    second (shorter ones in recordings below eight): neighbouring samples are too alike
    to score on.

    Args:
        robot: The arm.
        recordings: Logs of it, or motions made from such.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
    """
    motions, cutoff = prepare_motions(robot, recordings, cutoff)
    motions = [m for m in motions if m.mask.any()]
    if not motions:
        raise IdentificationError("no usable sample: every one is masked")
    usable = min(float(np.ptp(m.t[m.mask])) for m in motions)
    seconds = max(1e-3, min(_BLOCK_SECONDS, usable / (2 * FOLDS)))
    folds = []
    for r, motion in enumerate(motions):
        if len(motions) >= FOLDS:
            block = np.full(len(motion.t), r)
        else:
            block = ((motion.t - motion.t[0]) // seconds).astype(int)
        folds.append(block % FOLDS)
    return Data(tuple(motions), tuple(folds), cutoff, _STANDING * _fastest(motions))


def visited(data: Data) -> dict[str, Array]:
    """Lowest and highest position and highest speed, each of shape (n,)."""
    q = [m.q[m.mask] for m in data.motions]
    return {
        "q_min": np.min([x.min(axis=0) for x in q], axis=0),
        "q_max": np.max([x.max(axis=0) for x in q], axis=0),
        "v_max": _fastest(data.motions),
    }


def _fastest(motions: Sequence[Motion]) -> Array:
    """Highest speed of each joint, shape (n,)."""
    each = [np.abs(m.v[m.mask]).max(axis=0) for m in motions]
    return np.asarray(np.max(each, axis=0))


def predictions(model: DynamicModel, data: Data) -> list[Array]:
    """Torque of a model along each motion, shapes (N, n), [N·m]."""
    return [model.predict(motion) for motion in data.motions]
