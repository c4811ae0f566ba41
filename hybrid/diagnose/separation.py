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

from hybrid.diagnose.attribute import Search, Term
from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import Candidate
from hybrid.diagnose.gap import Columns, Gap
from hybrid.diagnose.shapes import nudges
from hybrid.diagnose.thresholds import thresholds
from hybrid.effects import Effect, effect_classes
from hybrid.robot.chain import Array


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation, fitted to the recordings there are.

    Attributes:
        candidate: What is special in it, with its fitted gains.
        others: What all explanations share.
        gains: Background, others, effect and small changes of its shapes, shape (k,).
        precision: What is known of them: inverse covariance, shape (k, k).
    """

    candidate: Candidate
    others: tuple[Candidate, ...]
    gains: Array
    precision: Array

    @property
    def effect(self) -> Effect:
        """What is special in it, with its fitted gains."""
        return self.candidate.effect


def fit_rival(search: Search, term: Term, candidate: Candidate) -> Rival:
    """A candidate in the place of a term, fitted to the samples of a search.

    Args:
        search: The search.
        term: One of its terms.
        candidate: The term's own, or another one with its shapes fitted.
    """
    gap, evidence, base = search.gap, search.evidence, search.base(term)
    (own,) = evidence.add([gap.columns(candidate.effect)], [candidate.std])
    solution = evidence.solve(np.concatenate([base, own]))
    fitted = dict(
        zip(
            [g.name for g in candidate.effect.gains],
            map(float, solution.gains[len(base) :]),
            strict=True,
        )
    )
    effect = candidate.effect.at(fitted)
    blocks = nudges(gap, effect)
    bends = evidence.add(blocks, [np.ones(1)] * len(blocks)) if blocks else []
    index = np.concatenate([base, own, *bends])
    A, _ = evidence.normal(index)
    gains = np.concatenate([solution.gains, np.zeros(len(bends))])
    others = tuple(t.candidate for t in search.terms if t is not term)
    known = A + np.diag(evidence.precision[index])
    return Rival(replace(candidate, effect=effect), others, gains, known)


def separation(ahead: Gap, noise: Array, first: Rival, second: Rival) -> float:
    """How far a motion sets two explanations apart, whichever of them is true.

    Args:
        ahead: The motion, see :func:`~hybrid.diagnose.menu.gap_along`.
        noise: Variance of each joint's noise for independent samples, shape (n,).
        first: One explanation.
        second: Another one.
    """
    sides = [_stacked(ahead, noise, _blocks(ahead, r)) for r in (first, second)]
    torques = [X @ r.gains for X, r in zip(sides, (first, second), strict=True)]
    off = torques[0] - torques[1]
    found = []
    for X, rival in zip(sides, (first, second), strict=True):
        b = X.T @ off
        followed = b @ np.linalg.solve(X.T @ X + rival.precision, b)
        found.append(max(float(off @ off - followed), 0.0))
    return float(np.sqrt(min(found)))


def contrast(search: Search, ahead: Gap, first: Rival, second: Rival) -> float:
    """How well the recordings and a motion would tell two explanations apart.

    One explanation's torque is appended to the recordings, and both are fitted to all
    of it, shapes too, however far that takes them. A law that another one has as a
    limit cannot be told from it if it is the true one.

    Args:
        search: The search that both explanations come from.
        ahead: The motion.
        first: One explanation.
        second: Another one.

    Returns:
        By how much the evidence differs, whichever of them is true, over what it must
        differ for them to be no more alike; 1 or more if they are told apart.
    """
    limits, found = thresholds(), []
    for true, other in ((first, second), (second, first)):
        both = _refit_search(search, ahead, true)
        gains = [_gain(search, both, rival.candidate) for rival in (true, other)]
        needed = max(limits.alike, limits.alike_share * gains[0])
        found.append((gains[0] - gains[1]) / needed)
    return max(min(found), 0.0)


def _gain(search: Search, both: Search, candidate: Candidate) -> float:
    """Evidence of an effect on all data, from the best of all shapes tried, [nat]."""
    same = [t.candidate for t in search.tried if t.place == candidate.place]
    base = both.base()
    start = max([candidate, *same], key=lambda c: both.gain(base, c))
    return both.refine(base, start)[1]


def _refit_search(search: Search, ahead: Gap, true: Rival) -> Search:
    """A search on the recordings and a motion on which one explanation is true."""
    gap, new = search.gap, np.zeros_like(ahead.left)
    start = 0
    for block in _blocks(ahead, true):
        width = next(iter(block.values())).shape[1]
        for i, x in block.items():
            new[:, i] += x @ true.gains[start : start + width]
        start += width
    both = Gap(
        gap.robot, (*gap.motions, *ahead.motions), (*gap.bodies, *ahead.bodies),
        gap.cutoff, np.concatenate([gap.left, new]),
        np.concatenate([gap.moving, ahead.moving]),
        np.concatenate([gap.fold, ahead.fold]),
        np.concatenate([gap.trajectory, ahead.trajectory + gap.trajectory.max() + 1]),
    )  # fmt: skip
    use = np.zeros(len(gap.fold), dtype=bool)
    for rows in search.evidence.rows:
        use[rows] = True
    use = np.concatenate([use, np.ones(len(new), dtype=bool)])
    fresh = Search(both, use, without=[*effect_classes()])
    fresh.evidence.noise = search.evidence.noise
    fresh.evidence.spread(fresh.background, search.off)
    for other in true.others:
        (index,) = fresh.evidence.add([both.columns(other.effect)], [other.std])
        fresh.terms.append(Term(other, index))
    return fresh


def _blocks(gap: Gap, rival: Rival) -> list[Columns]:
    """Columns of background, others, effect and nudges along a motion."""
    others = [gap.columns(c.effect) for c in rival.others]
    own = rival.effect
    return [*background(gap)[0], *others, gap.columns(own), *nudges(gap, own)]


def _stacked(gap: Gap, noise: Array, blocks: Sequence[Columns]) -> Array:
    """Columns of all joints on the samples where they move, in units of noise."""
    widths = [next(iter(b.values())).shape[1] for b in blocks]
    starts = np.concatenate([[0], np.cumsum(widths)])
    parts = []
    for i in range(gap.robot.size):
        rows = gap.moving[:, i]
        X = np.zeros((int(rows.sum()), starts[-1]))
        for block, start, width in zip(blocks, starts[:-1], widths, strict=True):
            if i in block:
                X[:, start : start + width] = block[i][rows]
        parts.append(X / np.sqrt(noise[i]))
    return np.concatenate(parts)
