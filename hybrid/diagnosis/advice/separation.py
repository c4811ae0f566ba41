"""Predict how well a new motion discriminates between two rival explanations.

Each rival has been fitted to the recordings. If one is true, it predicts the torque of
the new motion. The other is fitted to that torque, with a prior from the recordings.
The norm of its residual is the separation, in units of noise; half its square is the
expected evidence of the new motion.

Source: Atkinson and Fedorov 1975, doi 10.1093/biomet/62.1.57 (T-optimality).
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.candidates import Candidate, Term, with_gains
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.refine import add_shape_derivatives, gain, refine
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.explanations.other_samples import add_background
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.prior import Prior
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.regression.problem import part

_LONG_WAVES = 6  # per turn


@dataclass(frozen=True, eq=False)
class Rival:
    """One of two explanations, fitted to the recordings."""

    candidate: Candidate  # the effect in which it differs, with fitted gains
    others: tuple[Candidate, ...]  # the effects that both rivals share
    # Gains of the background, of the shared effects and of its own effect, and small
    # changes of its shapes, shape (k,).
    gains: Array
    precision: Array  # inverse posterior covariance of these, shape (k, k)
    prior: Array  # inverse prior variance of what both share, shape (s,)
    evidence: float  # log evidence of its own effect on the recordings, [nat]

    @property
    def effect(self) -> Effect:
        """The effect in which it differs, with fitted gains."""
        return self.candidate.effect


def fit_rival(search: Search, term: Term, candidate: Candidate) -> Rival:
    """Fit a candidate in the place of a term to the samples of a search."""
    evidence = search.evidence
    others = [t for t in search.terms if t.index is not term.index]
    base = np.concatenate([search.rigid, *(t.index for t in others)])
    columns = search.gap.columns(candidate.effect)
    (own,) = evidence.add([columns], [candidate.std])
    solution = evidence.solve(np.concatenate([base, own]))
    effect = with_gains(candidate.effect, solution.of(own))
    changes = add_shape_derivatives(evidence, effect)
    index = np.concatenate([solution.index, changes])
    A, _ = evidence.normal(index)
    prior = evidence.precision[index]
    return Rival(
        replace(candidate, effect=effect),
        tuple(t.candidate for t in others),
        np.concatenate([solution.gains, np.zeros(len(changes))]),
        A + np.diag(prior),
        prior[: len(base)],
        solution.evidence - evidence.solve(base).evidence - price(effect),
    )


def required_evidence(evidence: float) -> float:
    """Difference of evidence that distinguishes an explanation from another, [nat]."""
    prior = Prior()
    return float(max(-np.log(1.0 - prior.in_class), prior.law_error * evidence))


def tried_shapes(search: Search) -> list[Candidate]:
    """Candidates with all shapes that a search has tried, and with long waves."""
    tried = [t.candidate for t in search.pool.tried]
    waves = [
        c.at(c.effect.at({s.name: k}))
        for c in {c.place: c for c in tried}.values()
        for s in c.effect.shapes if s.unit == "1/turn"
        for k in range(1, _LONG_WAVES + 1)
    ]  # fmt: skip
    return [*tried, *waves]


class Outlook(Evidence):
    """Evidence along some motions, with the columns of rivals.

    Noise is its variance at each joint for independent samples, shape (n,).
    """

    def __init__(self, gap: Gap, noise: Array, use: Mask | None = None) -> None:
        super().__init__(gap, use)
        self.noise = noise
        self._rigid, _ = add_background(self, Prior())
        self._shared: dict[tuple[Candidate, ...], Index] = {}
        self._whole: dict[Rival, Index] = {}

    def shared(self, rival: Rival) -> Index:
        """Columns that a rival shares with the other one, with their prior, (s,)."""
        if rival.others not in self._shared:
            blocks = [self.gap.columns(c.effect) for c in rival.others]
            own = self.add(blocks, [c.std for c in rival.others])
            index = np.concatenate([self._rigid, *own])
            self.precision[index] = rival.prior
            self._shared[rival.others] = index
        return self._shared[rival.others]

    def whole(self, rival: Rival) -> Index:
        """Columns of all gains of a rival, shape (k,)."""
        if rival not in self._whole:
            columns = self.gap.columns(rival.effect)
            own = self.add([columns], [rival.candidate.std])
            changes = add_shape_derivatives(self, rival.effect)
            index = np.concatenate([self.shared(rival), *own, changes])
            self._whole[rival] = index
        return self._whole[rival]

    def torque(self, rival: Rival) -> Array:
        """Torque that a rival foresees where joints move, shape (M, n), [N·m]."""
        index, torque = self.whole(rival), np.zeros_like(self.gap.left)
        for i, rows in enumerate(self.rows):
            torque[rows, i] = self.fitted(i, index, rival.gains)
        return torque


class Discrimination:
    """Discrimination between rivals of a search by recordings and a motion ahead.

    Without recordings the motion, a gap of zero, will be diagnosed alone.
    """

    def __init__(self, search: Search, ahead: Gap, recorded: Gap | None) -> None:
        self._search, self._recorded = search, recorded
        self._ahead = Outlook(ahead, search.evidence.noise)

    @cached_property
    def _both(self) -> Outlook:
        """The recordings and the new motion."""
        if self._recorded is None:
            return self._ahead
        gap = joined(self._recorded, self._ahead.gap)
        use = np.ones(len(gap.fold), dtype=bool)
        use[: len(self._search.learn)] = self._search.learn
        return Outlook(gap, self._ahead.noise, use)

    def separation(self, first: Rival, second: Rival) -> float:
        """Separation of two rivals by the new motion, whichever of them is true."""
        view = self._ahead
        view.set_left(view.torque(first) - view.torque(second))
        apart, made_good = float(np.sum(view.power / view.noise)), []
        for rival in (first, second):
            A, b = view.normal(view.whole(rival))
            made_good.append(float(b @ np.linalg.solve(A + rival.precision, b)))
        return float(np.sqrt(max(apart - max(made_good), 0.0)))

    def contrast(self, first: Rival, second: Rival) -> tuple[float, float]:
        """Expected evidence between two rivals from the recordings and the motion.

        The torque that one rival predicts is appended to the recordings, and both are
        fitted to all of it, shapes included. A law that is a limit of the other cannot
        be distinguished from it if it is the true one. The difference if the first is
        true, and that if the second is, are over the one that is required.
        """
        tried = tried_shapes(self._search)

        def ratio(true: Rival, other: Rival) -> float:
            view, left = self._both, self._ahead.torque(true)
            if self._recorded is not None:
                left = np.concatenate([self._recorded.left, left])
            view.set_left(left)
            base = view.shared(true)
            # The shapes of the true law are known.
            best = gain(view, base, true.candidate)
            starts = [c for c in tried if c.place == other.candidate.place]
            start = max([other.candidate, *starts], key=partial(gain, view, base))
            _, found = refine(view, base, start)
            return (best - found) / required_evidence(best)

        return ratio(first, second), ratio(second, first)


def decimated(gap: Gap) -> Gap:
    """A gap with decimated motions, so that columns of effects take less time."""
    motions = tuple(part(m, slice(None, None, s.factor)) for m, _, s in gap)
    pairs = zip(motions, gap.bodies, strict=True)
    bodies = tuple(RigidBody(b.chain, m, b.inertial) for m, b in pairs)
    return replace(gap, motions=motions, bodies=bodies, healthy=())


def joined(one: Gap, other: Gap) -> Gap:
    """The motions of two gaps of an arm with the same cut-off and rate."""
    later = other.trajectory + one.trajectory.max(initial=-1) + 1
    both = replace(other, trajectory=later)
    stacked: dict[str, Any] = {
        name: np.concatenate([getattr(one, name), getattr(both, name)])
        for name in ("left", "moving", "fold", "trajectory")
    }
    motions, bodies = one.motions + other.motions, one.bodies + other.bodies
    return replace(one, motions=motions, bodies=bodies, healthy=(), joins=(one, other),
                   **stacked)  # fmt: skip
