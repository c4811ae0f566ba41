"""Torque that repeats with a joint's position: which orders a residual holds.

Every whole number of periods a turn is tried, as gears, cogging and eccentric shafts all
repeat with the joint or with a motor that is geared to it in whole numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.effects import Effect
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identify.cross_products import part
from hybrid.identify.data import FOLDS, Data, Rest, helps
from hybrid.robot.chain import Array
from hybrid.signals import Sampler

_MOST_PERIODS = 400
_MOST_RIPPLES = 4
_WORTH = 0.02  # least relative fall of squares for a ripple to stay
_BATCH = 50  # orders filtered at a time
_MOST_SECONDS = 120.0  # of data to search; the gains are then found on all of it


def find_ripples(data: Data, rest: Rest, joint: int) -> tuple[Effect, ...]:
    """Ripples of one joint that lower its residual on every fold, strongest first.

    Args:
        data: Motions with folds.
        rest: What the physical terms leave on folds they were not fitted on.
        joint: The joint.
    """
    pieces = _pieces(data, rest, joint)
    left = np.concatenate([p[1] for p in pieces])
    fold = np.concatenate([p[2] for p in pieces])
    periods = np.arange(1, _MOST_PERIODS + 1)
    waves = _waves(pieces, periods, data.cutoff)
    found: list[Effect] = []
    while len(found) < _MOST_RIPPLES:
        before, _ = _cross_validated(waves[:1, 2:], left, fold)
        after, gains = _cross_validated(waves, left, fold)
        best = int(after.sum(axis=1).argmin())
        if not helps(before[0], after[best], _WORTH):
            break
        left = left - gains[best] @ waves[best]
        shape = {"periods": float(periods[best])}
        found.append(TorqueRipple((joint,), shape))
    return tuple(found)


Piece = tuple[Array, Array, NDArray[np.intp], NDArray[np.bool_], float]


def _pieces(data: Data, rest: Rest, joint: int) -> list[Piece]:
    """Positions at full rate, residual and fold where the joint moves, and the rate."""
    pieces: list[Piece] = []
    left, fold = data.split(rest.tau[:, joint]), data.split(rest.fold)
    moving = data.split(rest.moving[:, joint])
    share = _MOST_SECONDS / sum(m.t[-1] - m.t[0] for m in data.motions)
    for motion, y, k, use in zip(data.motions, left, fold, moving, strict=True):
        sampler = Sampler.for_rate(motion.rate, data.cutoff)
        count = len(y) if share >= 1 else int(share * len(y))
        q = part(motion, slice(0, count * sampler.factor)).q[:, joint]
        count = -(-len(q) // sampler.factor)
        use = use[:count]
        pieces.append((q, y[:count][use], k[:count][use], use, motion.rate))
    return pieces


def _waves(pieces: Sequence[Piece], periods: NDArray[np.intp], cutoff: float) -> Array:
    """Filtered sine and cosine of every order, and a constant, shape (K, 3, M).

    What is left of the torque has lost the mean of a slow wave to the other terms; the
    constant gives it back.
    """
    columns = []
    for q, _, _, use, rate in pieces:
        sampler = Sampler.for_rate(rate, cutoff)
        rows = []
        for start in range(0, len(periods), _BATCH):
            angle = periods[start : start + _BATCH, None] * q
            pair = np.stack([np.sin(angle), np.cos(angle)], axis=1)
            rows.append(sampler(pair, axis=2)[:, :, use].astype(np.float32))
        pairs = np.concatenate(rows)
        columns.append(np.pad(pairs, ((0, 0), (0, 1), (0, 0)), constant_values=1.0))
    return np.concatenate(columns, axis=2)


def _cross_validated(
    waves: Array, left: Array, fold: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Squares on each fold by gains from the others (K, F), and gains on all (K, d)."""
    G, c, y = [], [], []
    for k in range(FOLDS):
        own = waves[:, :, fold == k].astype(float)
        G.append(own @ own.transpose(0, 2, 1))
        c.append(own @ left[fold == k])
        y.append(left[fold == k] @ left[fold == k])
    after = []
    for k in range(FOLDS):
        gains = _gains(sum(G) - G[k], sum(c) - c[k])
        fit = np.einsum("ki,ki->k", gains, c[k])
        power = np.einsum("ki,kij,kj->k", gains, G[k], gains)
        after.append(y[k] - 2 * fit + power)
    return np.stack(after, axis=1), _gains(sum(G), sum(c))


def _gains(G: Array, c: Array) -> Array:
    """Least-squares gains; a trace of ridge keeps columns that hardly differ apart."""
    ridge = 1e-6 * np.trace(G, axis1=1, axis2=2)[:, None, None] + 1e-12
    return np.asarray(np.linalg.solve(G + ridge * np.eye(G.shape[1]), c[:, :, None])[:, :, 0])
