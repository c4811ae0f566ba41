"""How far a new motion would set two explanations of the same data apart.

Each explanation has been fitted to the recordings there are. If one of them is true,
the new motion's torque is what it predicts; the other is fitted to that anew, held by
what the old recordings say of its parameters. What it cannot follow is the separation,
in units of noise: half its square is the evidence that the motion is expected to bring.

Source: Atkinson and Fedorov 1975, doi 10.1093/biomet/62.1.57 (T-optimality).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array
from hybrid.diagnosis.advice.along import Along
from hybrid.diagnosis.evidence.bayes import heavy_tailed
from hybrid.diagnosis.evidence.candidates import (
    Candidate,
    Term,
    scale_of,
    with_gains,
)
from hybrid.diagnosis.evidence.shapes import fit_shapes, price, shape_derivatives
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Columns
from hybrid.diagnosis.prior import Prior
from hybrid.effects import Effect

_EXACT_PASSES = 4
_LONG_WAVES = 6  # per turn


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation, fitted to the recordings there are.

    Attributes:
        candidate: What is special in it, with its fitted gains.
        others: What all explanations share.
        gains: Background, others, effect and small changes of its shapes, shape (k,).
        precision: What is known of them: inverse covariance, shape (k, k).
        prior: Inverse variance of what is shared before any recording, shape (s,).
        evidence: What it adds to what is shared, on the recordings, [nat].
    """

    candidate: Candidate
    others: tuple[Candidate, ...]
    gains: Array
    precision: Array
    prior: Array
    evidence: float

    @property
    def effect(self) -> Effect:
        """What is special in it, with its fitted gains."""
        return self.candidate.effect

    def stack(self, along: Along) -> list[Array]:
        """Columns of all its gains along motions, shape (R, k) at each joint."""
        return along.stack([*self.shared(along), *along.own(self.effect)])

    def shared(self, along: Along) -> list[Columns]:
        """Columns of what all explanations share."""
        return [*along.background, *(along.kept(c) for c in self.others)]


def fit_rival(search: Search, term: Term, candidate: Candidate) -> Rival:
    """A candidate in the place of a term, fitted to the samples of a search.

    Args:
        search: The search.
        term: One of its terms.
        candidate: The term's own, or another one with its shapes fitted.
    """
    gap, evidence = search.gap, search.evidence
    others = [t.index for t in search.terms if t.index is not term.index]
    base = np.concatenate([search.rigid, *others])
    (own,) = evidence.add([gap.columns(candidate.effect)], [candidate.std])
    solution = evidence.solve(np.concatenate([base, own]))
    effect = with_gains(candidate.effect, solution.gains[len(base) :])
    blocks = shape_derivatives(gap, effect)
    bends = evidence.add(blocks, [np.ones(1)] * len(blocks)) if blocks else []
    index = np.concatenate([base, own, *bends])
    A, _ = evidence.normal(index)
    prior = evidence.precision[index]
    return Rival(
        replace(candidate, effect=effect),
        tuple(t.candidate for t in search.terms if t.index is not term.index),
        np.concatenate([solution.gains, np.zeros(len(bends))]),
        A + np.diag(prior),
        prior[: len(base)],
        solution.evidence - evidence.solve(base).evidence - price(effect),
    )


def shapes_of(search: Search) -> list[Candidate]:
    """All shapes that a search has tried, and long waves, which other data may show."""
    tried = [t.candidate for t in search.pool.tried]
    for c in list({c.place: c for c in tried}.values()):
        for wave in (s.name for s in c.effect.shapes if s.unit == "1/turn"):
            long = (c.effect.at({wave: k}) for k in range(1, _LONG_WAVES + 1))
            tried += [replace(c, effect=effect) for effect in long]
    return tried


class Outlook:
    """What recordings and a motion to come would say together of explanations.

    Args:
        tried: Shapes from which an explanation's own are fitted; see :func:`shapes_of`.
        recorded: The recordings that the explanations were fitted to.
        ahead: The motion to come.
        alone: Whether the motion will be judged without the recordings.
    """

    def __init__(
        self,
        tried: Sequence[Candidate],
        recorded: Along,
        ahead: Along,
        *,
        alone: bool = False,
    ) -> None:
        self._tried = tried
        self._ahead = ahead
        self._parts = [ahead] if alone else [recorded, ahead]
        self._known: dict[tuple[Candidate, ...], _Known] = {}

    def separation(self, first: Rival, second: Rival) -> float:
        """How far the motion sets two explanations apart, whichever is true."""
        rivals = first, second
        sides = [r.stack(self._ahead) for r in rivals]
        torques = [
            np.concatenate([x @ r.gains for x in X])
            for X, r in zip(sides, rivals, strict=True)
        ]
        off, found = torques[0] - torques[1], []
        for parts, rival in zip(sides, rivals, strict=True):
            X = np.concatenate(parts)
            b = X.T @ off
            followed = b @ np.linalg.solve(X.T @ X + rival.precision, b)
            found.append(max(float(off @ off - followed), 0.0))
        return float(np.sqrt(min(found)))

    def contrast(self, first: Rival, second: Rival) -> tuple[float, float]:
        """How well the recordings and the motion would tell two explanations apart.

        One explanation's torque is appended to the recordings, and both are fitted to
        all of it, shapes too, however far that takes them. A law that another one has
        as a limit cannot be told from it if it is the true one.

        Returns:
            By how much the evidence differs if the first is true, and if the second
            is, over what it must differ for them to be no more alike; 1 or more if
            they are told apart.
        """

        def told(true: Rival, other: Rival) -> float:
            data = self._believe(true)
            # Its own law cannot do better than at the shapes that made the torque.
            best = self._trial(data, true.candidate)[0]
            return (best - self._gain(data, other.candidate)) / needed(best)

        return told(first, second), told(second, first)

    def _believe(self, true: Rival) -> _Told:
        """All the data there would be if an explanation were true."""
        if true.others not in self._known:
            stacks = [p.stack(true.shared(p)) for p in self._parts]
            self._known = {true.others: _Known(_joined(stacks), true.prior)}
        new = [X @ true.gains for X in true.stack(self._ahead)]
        old = [p.left for p in self._parts[:-1]]
        return _Told(self._known[true.others], _joined([*old, new]))

    def _gain(self, told: _Told, candidate: Candidate) -> float:
        """Evidence of an effect on all data, from the best of all shapes tried, [nat].

        The shapes are fitted as :meth:`Search.refine` does.
        """

        def gain(effect: Effect) -> float:
            return self._trial(told, replace(candidate, effect=effect))[0]

        same = [c for c in self._tried if c.place == candidate.place]
        grid = [(told.trial(self._columns(c), c)[0], c.effect) for c in same]
        start = max([(gain(candidate.effect), candidate.effect), *grid], key=_first)
        effect, best = fit_shapes(start[1], gain, self._ahead.gap)
        if best < start[0]:
            best, effect = start
        timed = effect.shifts and effect.gain_values.any()
        if effect.linearised and len(effect.gains) == 1 and not timed:
            bounds = effect.gains[0].scaled(scale_of(self._ahead.gap, effect))
            for _ in range(_EXACT_PASSES):
                best, gains = self._trial(told, replace(candidate, effect=effect))
                value = float(np.clip(gains[0], bounds.lower, bounds.upper))
                effect = effect.at({bounds.name: value})
        return best

    def _trial(self, told: _Told, c: Candidate) -> tuple[float, Array]:
        columns = [p.columns(c.effect) for p in self._parts]
        return told.trial(_appended(columns), c)

    def _columns(self, c: Candidate) -> Columns:
        return _appended([p.kept(c) for p in self._parts])


class _Known:
    """What all explanations share, along all motions.

    Args:
        X: Its columns at each joint, shape (R, s).
        prior: Inverse variance of its gains, shape (s,).
    """

    def __init__(self, X: Sequence[Array], prior: Array) -> None:
        # In units of the prior, which differ by many orders of magnitude.
        self.X, self.size = [x / np.sqrt(prior) for x in X], len(prior)
        gram = np.sum([x.T @ x for x in self.X], axis=0)
        self.factor = cho_factor(np.eye(len(prior)) + gram)


class _Told:
    """Data to be explained, beside what all explanations share.

    Args:
        known: What they share.
        y: Torque at each joint, in units of noise, shape (R,).
    """

    def __init__(self, known: _Known, y: Sequence[Array]) -> None:
        self._known, self._y = known, y
        moment = np.sum([x.T @ t for x, t in zip(known.X, y, strict=True)], axis=0)
        self._explained = cho_solve(known.factor, moment)

    def trial(self, columns: Columns, c: Candidate) -> tuple[float, Array]:
        """Evidence that a candidate's columns add, [nat], and their gains (p,)."""
        p = len(c.std)
        across, H, s = np.zeros((self._known.size, p)), np.zeros((p, p)), np.zeros(p)
        for i, x in columns.items():
            across += self._known.X[i].T @ x
            H += x.T @ x
            s += x.T @ self._y[i]
        H -= across.T @ cho_solve(self._known.factor, across)
        s -= across.T @ self._explained
        gain, gains, _ = heavy_tailed(H, s, c.std**-2.0, c.lower)
        return float(gain) - price(c.effect), gains


def needed(evidence: float) -> float:
    """By how much another explanation's evidence must differ not to be alike, [nat].

    Args:
        evidence: Of the explanation, [nat]; its law may be inexact.
    """
    prior = Prior()
    return float(max(-np.log(prior.alternative), prior.law_error * evidence))


def _joined(parts: Sequence[Sequence[Array]]) -> list[Array]:
    """Samples of all motions, joint by joint."""
    return [np.concatenate(x) for x in zip(*parts, strict=True)]


def _appended(parts: Sequence[Columns]) -> Columns:
    return {i: np.concatenate([p[i] for p in parts]) for i in parts[0]}


def _first(x: tuple[float, Effect]) -> float:
    return x[0]
