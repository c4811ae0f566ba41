"""Predict how well a new motion discriminates between two rival explanations.

Each rival has been fitted to the recordings. If one is true, it predicts the torque of
the new motion. The other is fitted to that torque, with a prior from the recordings.
The norm of its residual is the separation, in units of noise; half its square is the
expected evidence of the new motion.

Source: Atkinson and Fedorov 1975, doi 10.1093/biomet/62.1.57 (T-optimality).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.bayes import heavy_tailed
from hybrid.diagnosis.evidence.candidates import Candidate, Term, scale_of, with_gains
from hybrid.diagnosis.evidence.shapes import fit_shapes, price, shape_derivatives
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.background import (
    background,
    friction_near_rest,
    sampling_delays,
)
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.prior import Prior
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.regression.problem import part

_ITERATIONS = 4  # of the gain of a linearised effect
_LONG_WAVES = 6  # per turn


class WhitenedColumns:
    """Columns of effects along some motions, in units of noise.

    Args:
        gap: The motions.
        noise: Variance of each joint's noise for independent samples, shape (n,).
        rows: Samples of each joint to use; by default all in which it moves.
    """

    def __init__(
        self, gap: Gap, noise: Array, rows: Sequence[Index] | None = None
    ) -> None:
        self.gap = gap
        moving = [np.flatnonzero(x) for x in gap.moving.T]
        self.rows = moving if rows is None else list(rows)
        self._unit = 1.0 / np.sqrt(noise)
        self._cached: dict[Candidate, Columns] = {}

    def columns(self, effect: Effect) -> Columns:
        """Torque per unit of each gain, shape (R, p) at each joint that is reached."""
        return self._whitened(self.gap.columns(effect))

    def cached(self, candidate: Candidate) -> Columns:
        """The columns of a candidate, computed once."""
        if candidate not in self._cached:
            self._cached[candidate] = self.columns(candidate.effect)
        return self._cached[candidate]

    def with_shapes(self, effect: Effect) -> list[Columns]:
        """Columns of an effect, and of small changes of its shapes."""
        changes = [self._whitened(x) for x in shape_derivatives(self.gap, effect)]
        return [self.columns(effect), *changes]

    @cached_property
    def background(self) -> list[Columns]:
        """Columns of the simulator's own numbers."""
        makers = background, friction_near_rest, sampling_delays
        return [self._whitened(x) for make in makers for x in make(self.gap)[0]]

    @cached_property
    def residual(self) -> list[Array]:
        """Gap at each joint, shape (R,)."""
        return [self.gap.left[r, i] * self._unit[i] for i, r in enumerate(self.rows)]

    def stack(self, blocks: Sequence[Columns]) -> list[Array]:
        """Stack columns at every joint, shape (R, k) each; zero where there is none."""
        widths = [next(iter(b.values())).shape[1] for b in blocks]
        starts = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        found = []
        for i, rows in enumerate(self.rows):
            X = np.zeros((len(rows), starts[-1]))
            for block, start, width in zip(blocks, starts[:-1], widths, strict=True):
                if i in block:
                    X[:, start : start + width] = block[i]
            found.append(X)
        return found

    def _whitened(self, columns: Columns) -> Columns:
        return {i: x[self.rows[i]] * self._unit[i] for i, x in columns.items()}


def decimated(gap: Gap) -> Gap:
    """A gap with decimated motions, so that columns of effects take less time."""
    pairs = [(part(m, slice(None, None, s.factor)), b) for m, b, s in gap]
    return replace(
        gap,
        motions=tuple(m for m, _ in pairs),
        bodies=tuple(RigidBody(b.chain, m, b.inertial) for m, b in pairs),
    )


@dataclass(frozen=True, eq=False)
class Rival:
    """One of two explanations, fitted to the recordings.

    Attributes:
        candidate: The effect in which it differs, with fitted gains.
        others: The effects that both rivals share.
        gains: Gains of the background, of the shared effects and of its own effect, and
            small changes of its shapes, shape (k,).
        precision: Inverse posterior covariance of these, shape (k, k).
        prior: Inverse prior variance of what both share, shape (s,).
        evidence: Log evidence of its own effect on the recordings, [nat].
    """

    candidate: Candidate
    others: tuple[Candidate, ...]
    gains: Array
    precision: Array
    prior: Array
    evidence: float

    @property
    def effect(self) -> Effect:
        """The effect in which it differs, with fitted gains."""
        return self.candidate.effect

    def stack(self, motions: WhitenedColumns) -> list[Array]:
        """Columns of all its gains along motions, shape (R, k) at each joint."""
        return motions.stack([*self.shared(motions), *motions.with_shapes(self.effect)])

    def shared(self, motions: WhitenedColumns) -> list[Columns]:
        """Columns that both rivals share."""
        return [*motions.background, *(motions.cached(c) for c in self.others)]


def fit_rival(search: Search, term: Term, candidate: Candidate) -> Rival:
    """Fit a candidate in the place of a term to the samples of a search."""
    gap, evidence = search.gap, search.evidence
    others = [t.index for t in search.terms if t.index is not term.index]
    base = np.concatenate([search.rigid, *others])
    (own,) = evidence.add([gap.columns(candidate.effect)], [candidate.std])
    solution = evidence.solve(np.concatenate([base, own]))
    effect = with_gains(candidate.effect, solution.gains[len(base) :])
    blocks = shape_derivatives(gap, effect)
    changes = evidence.add(blocks, [np.ones(1)] * len(blocks)) if blocks else []
    index = np.concatenate([base, own, *changes])
    A, _ = evidence.normal(index)
    prior = evidence.precision[index]
    return Rival(
        replace(candidate, effect=effect),
        tuple(t.candidate for t in search.terms if t.index is not term.index),
        np.concatenate([solution.gains, np.zeros(len(changes))]),
        A + np.diag(prior),
        prior[: len(base)],
        solution.evidence - evidence.solve(base).evidence - price(effect),
    )


def tried_shapes(search: Search) -> list[Candidate]:
    """Candidates with all shapes that a search has tried, and with long waves."""
    tried = [t.candidate for t in search.pool.tried]
    for c in list({c.place: c for c in tried}.values()):
        for wave in (s.name for s in c.effect.shapes if s.unit == "1/turn"):
            long = (c.effect.at({wave: k}) for k in range(1, _LONG_WAVES + 1))
            tried += [replace(c, effect=effect) for effect in long]
    return tried


class _Data:
    """Torque y in units of noise, (R,) at each joint, and shared columns X, (R, s)."""

    def __init__(self, X: Sequence[Array], y: Sequence[Array]) -> None:
        self._X, self._y = X, y
        gram = np.sum([x.T @ x for x in X], axis=0)
        self._factor = cho_factor(np.eye(len(gram)) + gram)
        moment = np.sum([x.T @ t for x, t in zip(X, y, strict=True)], axis=0)
        self._gains = cho_solve(self._factor, moment)

    def evidence(self, columns: Columns, c: Candidate) -> tuple[float, Array]:
        """Log evidence of a candidate's columns, [nat], and their gains, (p,)."""
        p = len(c.std)
        across, H, s = np.zeros((len(self._gains), p)), np.zeros((p, p)), np.zeros(p)
        for i, x in columns.items():
            across += self._X[i].T @ x
            H += x.T @ x
            s += x.T @ self._y[i]
        H -= across.T @ cho_solve(self._factor, across)
        s -= across.T @ self._gains
        gain, gains, _ = heavy_tailed(H, s, c.std**-2.0, c.lower)
        return float(gain) - price(c.effect), gains


class Discrimination:
    """Discrimination between rivals by recordings together with a new motion.

    Args:
        tried: Candidates with start values of shapes; see :func:`tried_shapes`.
        recorded: The recordings to which the rivals were fitted.
        ahead: The new motion.
        alone: Whether the new motion will be diagnosed without the recordings.
    """

    def __init__(
        self,
        tried: Sequence[Candidate],
        recorded: WhitenedColumns,
        ahead: WhitenedColumns,
        *,
        alone: bool = False,
    ) -> None:
        self._tried = tried
        self._ahead = ahead
        self._parts = [ahead] if alone else [recorded, ahead]
        self._shared: dict[tuple[Candidate, ...], list[Array]] = {}

    def separation(self, first: Rival, second: Rival) -> float:
        """Separation of two rivals by the new motion, whichever of them is true."""
        one, two = (np.concatenate(r.stack(self._ahead)) for r in (first, second))
        difference, found = one @ first.gains - two @ second.gains, []
        for X, rival in ((one, first), (two, second)):
            b = X.T @ difference
            fitted = b @ np.linalg.solve(X.T @ X + rival.precision, b)
            found.append(max(float(difference @ difference - fitted), 0.0))
        return float(np.sqrt(min(found)))

    def contrast(self, first: Rival, second: Rival) -> tuple[float, float]:
        """Expected evidence between two rivals from the recordings and the motion.

        The torque that one rival predicts is appended to the recordings, and both are
        fitted to all of it, shapes included. A law that is a limit of the other cannot
        be distinguished from it if it is the true one.

        Returns:
            Difference of evidence if the first is true, and if the second is, over the
            difference that is required; 1 or more if they are distinguished.
        """

        def ratio(true: Rival, other: Rival) -> float:
            data = self._predicted(true)
            # The shapes of the true law are known.
            best = self._evidence_at(data, true.candidate)[0]
            found = self._best_evidence(data, other.candidate)
            return (best - found) / required_evidence(best)

        return ratio(first, second), ratio(second, first)

    def _predicted(self, true: Rival) -> _Data:
        """Recordings and the torque of the new motion, if a rival is true."""
        if true.others not in self._shared:
            stacks = [p.stack(true.shared(p)) for p in self._parts]
            # Scaled by the prior, as columns differ by many orders of magnitude.
            scaled = [X / np.sqrt(true.prior) for X in _joined(stacks)]
            self._shared = {true.others: scaled}
        new = [X @ true.gains for X in true.stack(self._ahead)]
        old = [p.residual for p in self._parts[:-1]]
        return _Data(self._shared[true.others], _joined([*old, new]))

    def _best_evidence(self, data: _Data, candidate: Candidate) -> float:
        """Evidence of an effect with fitted shapes, from the best start value, [nat].

        The shapes are fitted as :meth:`Search.refine` does.
        """

        def evidence(effect: Effect) -> float:
            return self._evidence_at(data, replace(candidate, effect=effect))[0]

        start = evidence(candidate.effect), candidate.effect
        for c in self._tried:
            if c.place == candidate.place:
                columns = _appended([p.cached(c) for p in self._parts])
                found = data.evidence(columns, c)[0]
                start = max(start, (found, c.effect), key=itemgetter(0))
        effect, best = fit_shapes(start[1], evidence, self._ahead.gap)
        if best < start[0]:
            best, effect = start
        timed = effect.shifts and effect.gain_values.any()
        if effect.linearised and len(effect.gains) == 1 and not timed:
            bounds = effect.gains[0].scaled(scale_of(self._ahead.gap, effect))
            for _ in range(_ITERATIONS):
                best, gains = self._evidence_at(data, replace(candidate, effect=effect))
                value = float(np.clip(gains[0], bounds.lower, bounds.upper))
                effect = effect.at({bounds.name: value})
        return best

    def _evidence_at(self, data: _Data, c: Candidate) -> tuple[float, Array]:
        """Evidence of a candidate at its shapes, [nat], and its gains (p,)."""
        return data.evidence(_appended([p.columns(c.effect) for p in self._parts]), c)


def required_evidence(evidence: float) -> float:
    """Difference of evidence that distinguishes an explanation from another, [nat]."""
    prior = Prior()
    return float(max(-np.log(prior.alternative), prior.law_error * evidence))


def _joined(parts: Sequence[Sequence[Array]]) -> list[Array]:
    """Concatenate the samples of all motions at each joint."""
    return [np.concatenate(x) for x in zip(*parts, strict=True)]


def _appended(parts: Sequence[Columns]) -> Columns:
    return {i: np.concatenate([p[i] for p in parts]) for i in parts[0]}
