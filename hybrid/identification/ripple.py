"""Torque that repeats with a joint's position: which orders a residual holds.

Every whole number of periods a turn is tried, as gears, cogging and eccentric shafts
all repeat with the joint or with a motor that is geared to it in whole numbers. What
each could explain alone follows from one Fourier transform of the residual over the
position. A slow wave looks much like gravity: the best orders are judged with all other
terms fitted anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.effects import Effect, JointState
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identification.data import Data
from hybrid.identification.partial_regression import PartialRegression
from hybrid.identification.solution import Solution
from hybrid.regression.problem import part
from hybrid.signals import Motion, Sampler, butterworth_gain

_MOST_PERIODS = 400
_MOST_RIPPLES = 4
_SHORTLIST = 8  # orders judged exactly
_SLOW = 8  # orders that may look like gravity, and are always judged exactly
JUDGED = _SHORTLIST + _SLOW
_BINS = 4096  # of position in a turn: ten for the shortest period
_SPEEDS = 64  # bins of speed
_FEWEST = 0.1  # of the moving samples have to show an order in band
_FALSE_ALARMS = 0.01  # chance that one of all orders passes on a joint without ripple
_BLOCK_SECONDS = 1.0  # apart for the scores of samples to be independent
_MOST_SECONDS = 120.0  # of data to search; the gains are then found on all of it


# Motion, joint and periods -> filtered sine and cosine of a ripple, shape (2, M).
Waves = dict[tuple[int, int, int], Array]


def find_ripples(
    data: Data, solution: Solution, waves: Waves
) -> dict[int, list[Effect]]:
    """Ripples of each joint that lower its error on unseen folds, strongest first.

    Args:
        data: Motions with folds.
        solution: The physical terms so far.
        waves: What was made of these data already; what is new is added.
    """
    pieces = enumerate(_pieces(data, solution, waves))
    found = {j: _ripples(j, own, solution, data.cutoff) for j, own in pieces}
    return {j: ripples for j, ripples in found.items() if ripples}


def _ripples(
    joint: int, pieces: Sequence[_Piece], solution: Solution, cutoff: float
) -> list[Effect]:
    rows = np.concatenate([p.rows for p in pieces], axis=1)
    terms = PartialRegression.of(solution, joint, rows)
    fold = np.concatenate([p.fold for p in pieces])
    block = np.concatenate([1000 * r + p.block for r, p in enumerate(pieces)])
    chance = _FALSE_ALARMS / _MOST_PERIODS
    found: list[Effect] = []
    while len(found) < _MOST_RIPPLES:
        left = np.split(terms.left, np.cumsum([p.rows.shape[1] for p in pieces])[:-1])
        periods = _shortlist(pieces, left, cutoff)
        if not len(periods):
            break
        ripples = [_ripple(joint, int(k), pieces, cutoff) for k in periods]
        waves = np.concatenate([p.waves(ripples) for p in pieces], axis=2)
        before, after = terms.cross_validated(waves, fold)
        best = int(after.sum(axis=1).argmin())
        if not (
            after[best].sum() < before.sum() and terms.shows(waves[best], block, chance)
        ):
            break
        terms = terms.with_wave(waves[best])
        found.append(ripples[best])
    return found


def in_band(effect: Effect, cutoff: float) -> Effect:
    """A ripple that acts only where a fit below a cut-off sees it.

    Args:
        effect: The ripple.
        cutoff: Cut-off of columns and torque, [Hz].
    """
    highest = 2 * np.pi * cutoff / effect.values["periods"]
    return effect.at({"fastest": min(effect.values["fastest"], highest)})


@dataclass(frozen=True)
class _Piece:
    """Moving samples of a joint in one motion.

    Attributes:
        number: Which of the motions.
        motion: It, at the rate the fit works at.
        joint: The joint.
        sampler: Filter and decimation.
        use: Which decimated samples the following are.
        rows: Columns of the joint, and what the solution leaves last, (d + 1, M).
        fold: Fold of each sample, shape (M,).
        block: Block in time of each sample, shape (M,).
        known: Waves made already.
    """

    number: int
    motion: Motion
    joint: int
    sampler: Sampler
    use: NDArray[np.bool_]
    rows: Array
    fold: NDArray[np.intp]
    block: NDArray[np.intp]
    known: Waves

    @property
    def q(self) -> Array:
        """Position, shape (N,), [rad]."""
        return self.motion.q[:, self.joint]

    @property
    def v(self) -> Array:
        """Speed, shape (N,), [rad/s]."""
        return self.motion.v[:, self.joint]

    def waves(self, ripples: Sequence[Effect]) -> Array:
        """Filtered sine and cosine of K ripples, shape (K, 2, M)."""
        zero = np.zeros_like(self.q)
        state = JointState(zero, self.q, self.v, zero, zero, zero)
        keys = [(self.number, self.joint, int(x.values["periods"])) for x in ripples]
        new = {k: x for k, x in zip(keys, ripples, strict=True) if k not in self.known}
        if new:
            pairs = [TorqueRipple.law(state, **x.shape_values) for x in new.values()]
            made = self.sampler(np.array(pairs), axis=2)[:, :, self.use]
            self.known.update(zip(new, made, strict=True))
        return np.stack([self.known[k] for k in keys])

    def spread(self, left: Array) -> Array:
        """What is left, back at the rate of the motion and filtered again, (N,)."""
        full = np.zeros(len(self.q))
        few = full[:: self.sampler.factor]
        few[self.use] = left
        return replace(self.sampler, factor=1)(full)


def _pieces(data: Data, solution: Solution, waves: Waves) -> list[list[_Piece]]:
    """What concerns each joint, of every motion."""
    problem, theta = solution.problem, solution.settled.theta
    share = _MOST_SECONDS / sum(m.t[-1] - m.t[0] for m in data.motions)
    found: list[list[_Piece]] = [[] for _ in range(problem.chain.size)]
    for r, (motion, fold) in enumerate(zip(data.motions, data.folds, strict=True)):
        sampler = Sampler.for_rate(motion.rate, data.cutoff)
        total = int(min(1.0, share) * len(motion.t))
        chunks = data.chunks(problem, motion, total)
        whole = np.concatenate([D for _, D, _ in chunks], axis=1)
        short, few = part(motion, slice(0, total)), slice(0, total, sampler.factor)
        block = ((motion.t[few] - motion.t[0]) // _BLOCK_SECONDS).astype(int)
        moves = data.moves(short)[:: sampler.factor]
        for joint, own in enumerate(found):
            use = moves[:, joint]
            rows = whole[problem.offsets[joint] : problem.offsets[joint + 1], use]
            rows[-1] -= theta[problem.support[joint]] @ rows[:-1]
            own.append(
                _Piece(
                    r,
                    short,
                    joint,
                    sampler,
                    use,
                    rows,
                    fold[few][use],
                    block[use],
                    waves,
                )  # fmt: skip
            )
    return found


def _ripple(
    joint: int, periods: int, pieces: Sequence[_Piece], cutoff: float
) -> TorqueRipple:
    """A ripple that acts as fast as was seen, as far as the samples can show it."""
    rate = min(p.motion.rate for p in pieces)
    fastest = max(float(np.abs(p.v).max()) for p in pieces)
    # Faster ones would be taken for others at the rate of the samples.
    shown = 2 * np.pi * max(rate / 2 - cutoff, cutoff) / periods
    values = {"periods": float(periods), "fastest": min(fastest, shown)}
    return TorqueRipple((joint,), values)


def _shortlist(
    pieces: Sequence[_Piece], left: Sequence[Array], cutoff: float
) -> NDArray[np.intp]:
    """Orders that could explain most, each alone, of those that enough samples show."""
    periods = np.arange(1, _MOST_PERIODS + 1)
    spectrum, seen, samples = np.zeros(_MOST_PERIODS), np.zeros(_MOST_PERIODS), 0
    total = np.zeros(_BINS)
    for piece, x in zip(pieces, left, strict=True):
        at = np.floor(piece.q / (2 * np.pi) * _BINS).astype(int) % _BINS
        total += np.bincount(at, weights=piece.spread(x), minlength=_BINS)
        speed = np.abs(piece.v[:: piece.sampler.factor][piece.use])
        count, edges = np.histogram(speed, bins=_SPEEDS)
        frequency = periods[:, None] * (edges[1:] + edges[:-1]) / (4 * np.pi)
        gain = butterworth_gain(frequency, rate=piece.motion.rate, cutoff=cutoff)
        seen += gain**2 @ count
        samples += len(speed)
    spectrum = np.abs(np.fft.rfft(total)[1 : _MOST_PERIODS + 1]) ** 2
    worth = np.where(seen > _FEWEST * samples, spectrum / np.maximum(seen, 1e-300), 0.0)
    # What noise explains is exponential over the orders: the best of all by chance.
    noise = np.median(worth[worth > 0]) / np.log(2) if worth.any() else 0.0
    best = np.argsort(-worth)[:_SHORTLIST]
    best = best[worth[best] > np.log(_MOST_PERIODS) * noise]
    slow = np.flatnonzero(seen[:_SLOW] > _FEWEST * samples)
    return np.asarray(periods[np.union1d(best, slow)])
