"""Torque that repeats with a joint's position: which orders a residual holds.

Every whole number of periods a turn is tried, as gears, cogging and eccentric shafts
all repeat with the joint or with a motor that is geared to it in whole numbers. A slow
wave looks much like gravity: each order is judged with all other terms fitted anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.effects import Effect
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identify.cross_products import moving_samples, part, sampled_chunks
from hybrid.identify.data import Data, helps
from hybrid.identify.partial_regression import PartialRegression
from hybrid.identify.solution import Solution
from hybrid.robot.chain import Array
from hybrid.signals import Sampler

_MOST_PERIODS = 400
_MOST_RIPPLES = 4
_WORTH = 0.02  # least relative fall of squares for a ripple to stay
_FALSE_ALARMS = 0.01  # chance that one of all orders passes on a joint without ripple
_BLOCK_SECONDS = 1.0  # apart for the scores of samples to be independent
_BATCH = 50  # orders filtered at a time
_MOST_SECONDS = 120.0  # of data to search; the gains are then found on all of it


def find_ripples(data: Data, solution: Solution, joint: int) -> tuple[Effect, ...]:
    """Ripples of one joint that lower its error on every fold, strongest first.

    Args:
        data: Motions with folds.
        solution: The physical terms so far.
        joint: The joint.
    """
    pieces = _pieces(data, solution, joint)
    rows = np.concatenate([p.rows for p in pieces], axis=1)
    terms = PartialRegression.of(solution, joint, rows)
    fold = np.concatenate([p.fold for p in pieces])
    block = np.concatenate([1000 * r + p.block for r, p in enumerate(pieces)])
    periods = np.arange(1, _MOST_PERIODS + 1)
    waves = np.concatenate([_waves(p, periods, data.cutoff) for p in pieces], axis=2)
    chance = _FALSE_ALARMS / _MOST_PERIODS
    found: list[Effect] = []
    while len(found) < _MOST_RIPPLES:
        before, after = terms.cross_validated(waves, fold)
        best = int(after.sum(axis=1).argmin())
        wave = waves[best].astype(float)
        if not (
            helps(before, after[best], _WORTH) and terms.shows(wave, block, chance)
        ):
            break
        terms = terms.with_wave(wave)
        found.append(TorqueRipple((joint,), {"periods": float(periods[best])}))
    return tuple(found)


@dataclass(frozen=True)
class _Piece:
    """Moving samples of a joint in one motion.

    Attributes:
        q: Position at full rate, shape (N,), [rad].
        rate: Samples of it per second, [Hz].
        use: Which decimated samples the following are.
        rows: Columns of the joint, and what the solution leaves last, (d + 1, M).
        fold: Fold of each sample, shape (M,).
        block: Block in time of each sample, shape (M,).
    """

    q: Array
    rate: float
    use: NDArray[np.bool_]
    rows: Array
    fold: NDArray[np.intp]
    block: NDArray[np.intp]


def _pieces(data: Data, solution: Solution, joint: int) -> list[_Piece]:
    problem = solution.problem
    own = slice(problem.offsets[joint], problem.offsets[joint + 1])
    theta = solution.estimate.theta[problem.support[joint]]
    share = _MOST_SECONDS / sum(m.t[-1] - m.t[0] for m in data.motions)
    pieces = []
    for motion, fold in zip(data.motions, data.folds, strict=True):
        sampler = Sampler.for_rate(motion.rate, data.cutoff)
        motion = part(motion, slice(0, int(min(1.0, share) * len(motion.t))))
        chunks = sampled_chunks(lambda m: problem.rows(m)[own], motion, sampler)
        rows = np.concatenate([D for _, D in chunks], axis=1)
        rows[-1] -= theta @ rows[:-1]
        use = moving_samples(motion, sampler, data.standing)[:, joint]
        own_fold = fold[: len(motion.t) : sampler.factor][use]
        t = motion.t[:: sampler.factor][use] - motion.t[0]
        block = (t // _BLOCK_SECONDS).astype(int)
        q = motion.q[:, joint]
        pieces.append(_Piece(q, motion.rate, use, rows[:, use], own_fold, block))
    return pieces


def _waves(piece: _Piece, periods: NDArray[np.intp], cutoff: float) -> Array:
    """Filtered sine and cosine of every order, shape (K, 2, M)."""
    sampler = Sampler.for_rate(piece.rate, cutoff)
    found = []
    for start in range(0, len(periods), _BATCH):
        angle = periods[start : start + _BATCH, None] * piece.q
        pair = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        found.append(sampler(pair, axis=2)[:, :, piece.use].astype(np.float32))
    return np.concatenate(found)
