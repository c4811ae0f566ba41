"""Search for torque ripple: the orders of a residual that repeat with the position.

Gears, cogging and eccentric shafts repeat with the joint or with its motor, so every
whole number of periods per turn is tried. One Fourier transform of the residual over
the position shows how much each order could explain alone. A slow wave looks like
gravity, so the best orders are tested with all other terms fitted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.effects import Effect, JointState
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identification.partial_regression import PartialRegression
from hybrid.identification.solution import Solution
from hybrid.regression.problem import part
from hybrid.signals import Sampler, butterworth_gain

_MOST_PERIODS = 400  # in a turn
_MOST_RIPPLES = 4  # of a joint
_BEST_ORDERS = 8  # tested with all other terms
_SLOW_ORDERS = 8  # lowest orders, always tested since they may look like gravity
JUDGED = _BEST_ORDERS + _SLOW_ORDERS
_BINS = 4096  # of position in a turn: ten for the shortest period
_SPEED_BINS = 64
_FEWEST = 0.1  # of the moving samples that must have an order below the cut-off
_FALSE_ALARMS = 0.01  # probability that an order passes on a joint without ripple
_BLOCK_SECONDS = 1.0  # distance at which samples count as independent
_MOST_SECONDS = 120.0  # of data to search; gains are then fitted to all data


def find_ripples(solution: Solution) -> dict[int, list[Effect]]:
    """Ripples of each joint that lower its held-out error, strongest first."""
    pieces = enumerate(_pieces(solution))
    found = {j: _ripples(j, own, solution) for j, own in pieces}
    return {j: ripples for j, ripples in found.items() if ripples}


def _ripples(joint: int, pieces: Sequence[_Piece], solution: Solution) -> list[Effect]:
    rows = np.concatenate([p.rows for p in pieces], axis=1)
    terms = PartialRegression.of(solution, joint, rows)
    cutoff = solution.products.data.cutoff
    fold = np.concatenate([p.fold for p in pieces])
    block = np.concatenate([1000 * r + p.block for r, p in enumerate(pieces)])
    ends = np.cumsum([len(p.fold) for p in pieces])
    chance = _FALSE_ALARMS / _MOST_PERIODS
    found: list[Effect] = []

    @cache  # an order is tried again after others were found
    def wave(periods: int) -> Array:
        ripple = _ripple(joint, periods, pieces, cutoff)
        return np.concatenate([p.wave(ripple) for p in pieces], axis=1)

    while len(found) < _MOST_RIPPLES:
        residual = np.split(terms.residual, ends[:-1])
        periods = _best_orders(pieces, residual, cutoff)
        if not periods:
            break
        before, after = terms.cross_validated([wave(k) for k in periods], fold)
        best = periods[after.sum(axis=1).argmin()]
        lower = after.sum(axis=1).min() < before.sum()
        if not (lower and terms.is_significant(wave(best), block, chance)):
            break
        terms = terms.with_wave(wave(best))
        found.append(_ripple(joint, best, pieces, cutoff))
    return found


def in_band(effect: Effect, cutoff: float) -> Effect:
    """A ripple limited to speeds at which its frequency is below a cut-off."""
    highest = 2 * np.pi * cutoff / effect.values["periods"]
    return effect.at({"fastest": min(effect.values["fastest"], highest)})


@dataclass(frozen=True)
class _Piece:
    """Moving samples of a joint in one motion.

    Attributes:
        q: Positions of the joint at the full rate, shape (N,), [rad].
        v: Its speeds, shape (N,), [rad/s].
        sampler: Filter and decimation.
        use: Which of the decimated samples are used: the M moving ones.
        rows: Columns of the joint, then the residual of the solution, (d + 1, M).
        fold: Fold of each sample, shape (M,).
        block: Block in time of each sample, shape (M,).
    """

    q: Array
    v: Array
    sampler: Sampler
    use: Mask
    rows: Array
    fold: Index
    block: Index

    def wave(self, ripple: Effect) -> Array:
        """Filtered sine and cosine of a ripple, shape (2, M)."""
        zero = np.zeros_like(self.q)
        state = JointState(zero, self.q, self.v, zero, zero, zero)
        pair = TorqueRipple.law(state, **ripple.shape_values)
        return self.sampler(np.array(pair), axis=1)[:, self.use]

    def refiltered(self, residual: Array) -> Array:
        """A residual at the rate of the motion, filtered again, shape (N,)."""
        full = np.zeros(len(self.q))
        few = full[:: self.sampler.factor]
        few[self.use] = residual
        return replace(self.sampler, factor=1)(full)


def _pieces(solution: Solution) -> list[list[_Piece]]:
    """The moving samples of every motion, for each joint."""
    problem, theta = solution.problem, solution.weighted.theta
    data = solution.products.data
    share = _MOST_SECONDS / sum(m.t[-1] - m.t[0] for m in data.motions)
    found: list[list[_Piece]] = [[] for _ in range(problem.chain.size)]
    for motion, fold in zip(data.motions, data.folds, strict=True):
        sampler, total = data.sampler(motion.rate), int(min(1.0, share) * len(motion.t))
        short = part(motion, slice(0, total))
        begun = [D for _, D, _ in data.rows(problem, motion, total)]
        whole = np.concatenate(begun, axis=1)[:, : -(-total // sampler.factor)]
        block = ((sampler.keep(short.t) - motion.t[0]) // _BLOCK_SECONDS).astype(int)
        own, moves = sampler.keep(fold[: len(short.t)]), sampler.keep(data.moves(short))
        for joint, every in enumerate(np.split(whole, problem.offsets[1:-1])):
            q, v, use = short.q[:, joint], short.v[:, joint], moves[:, joint]
            rows = every[:, use]
            rows[-1] -= theta[problem.support[joint]] @ rows[:-1]
            piece = _Piece(q, v, sampler, use, rows, own[use], block[use])
            found[joint].append(piece)
    return found


def _ripple(
    joint: int, periods: int, pieces: Sequence[_Piece], cutoff: float
) -> TorqueRipple:
    """A ripple that acts up to the highest speed that the sampling rate can resolve."""
    rate = min(p.sampler.rate for p in pieces)
    fastest = max(float(np.abs(p.v).max()) for p in pieces)
    # Above this speed the samples would alias.
    shown = 2 * np.pi * max(rate / 2 - cutoff, cutoff) / periods
    values = {"periods": float(periods), "fastest": min(fastest, shown)}
    return TorqueRipple((joint,), values)


def _best_orders(
    pieces: Sequence[_Piece], residual: Sequence[Array], cutoff: float
) -> list[int]:
    """Orders that explain most alone, of those in band, and the slow ones in band."""
    periods = np.arange(1, _MOST_PERIODS + 1)
    seen, total, samples = np.zeros(_MOST_PERIODS), np.zeros(_BINS), 0
    for piece, x in zip(pieces, residual, strict=True):
        at = np.floor(piece.q / (2 * np.pi) * _BINS).astype(int) % _BINS
        total += np.bincount(at, weights=piece.refiltered(x), minlength=_BINS)
        speed = np.abs(piece.v[:: piece.sampler.factor][piece.use])
        count, edges = np.histogram(speed, bins=_SPEED_BINS)
        frequency = periods[:, None] * (edges[1:] + edges[:-1]) / (4 * np.pi)
        gain = butterworth_gain(frequency, rate=piece.sampler.rate, cutoff=cutoff)
        seen += gain**2 @ count
        samples += len(speed)
    spectrum = np.abs(np.fft.rfft(total)[1 : _MOST_PERIODS + 1]) ** 2
    worth = np.where(seen > _FEWEST * samples, spectrum / np.maximum(seen, 1e-300), 0.0)
    # The power of noise is exponentially distributed: compare with its mean maximum.
    noise = np.median(worth[worth > 0]) / np.log(2) if worth.any() else 0.0
    best = np.argsort(-worth)[:_BEST_ORDERS]
    best = best[worth[best] > np.log(_MOST_PERIODS) * noise]
    slow = np.flatnonzero(seen[:_SLOW_ORDERS] > _FEWEST * samples)
    return [int(k) for k in periods[np.union1d(best, slow)]]
