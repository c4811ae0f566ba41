"""How far a new motion would set two explanations of the same data apart.

Each explanation has been fitted to the recordings there are. If one of them is true,
the new motion's torque is what it predicts; the other is fitted to that anew, held by
what the old recordings say of its parameters. What it cannot follow is the separation,
in units of noise: half its square is the evidence that the motion is expected to bring.

Source: Atkinson and Fedorov 1975, doi 10.1093/biomet/62.1.57 (T-optimality).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.diagnose.attribute import Search, Term
from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import Candidate
from hybrid.diagnose.gap import Columns, Gap
from hybrid.effects import Effect
from hybrid.robot.chain import Array

_NUDGE = 0.02  # of the range of a shape


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation, fitted to the recordings there are.

    Attributes:
        effect: What is special in it, with its fitted gains.
        others: Effects that all explanations share.
        gains: Background, others, effect and small changes of its shapes, shape (k,).
        precision: What is known of them: inverse covariance, shape (k, k).
    """

    effect: Effect
    others: tuple[Effect, ...]
    gains: Array
    precision: Array


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
    blocks = _nudges(gap, effect)
    nudges = evidence.add(blocks, [np.ones(1)] * len(blocks)) if blocks else []
    index = np.concatenate([base, own, *nudges])
    A, _ = evidence.normal(index)
    gains = np.concatenate([solution.gains, np.zeros(len(nudges))])
    others = tuple(t.candidate.effect for t in search.terms if t is not term)
    return Rival(effect, others, gains, A + np.diag(evidence.precision[index]))


def separation(ahead: Gap, noise: Array, first: Rival, second: Rival) -> float:
    """How far a motion sets two explanations apart, whichever of them is true.

    Args:
        ahead: The motion, see :func:`~hybrid.diagnose.menu.gap_along`.
        noise: Variance of each joint's noise for independent samples, shape (n,).
        first: One explanation.
        second: Another one.
    """
    shared = [*background(ahead)[0], *(ahead.columns(e) for e in first.others)]
    sides = [
        _stacked(ahead, noise, [*shared, ahead.columns(e), *_nudges(ahead, e)])
        for e in (first.effect, second.effect)
    ]
    torques = [X @ r.gains for X, r in zip(sides, (first, second), strict=True)]
    off = torques[0] - torques[1]
    found = []
    for X, rival in zip(sides, (first, second), strict=True):
        b = X.T @ off
        followed = b @ np.linalg.solve(X.T @ X + rival.precision, b)
        found.append(max(float(off @ off - followed), 0.0))
    return float(np.sqrt(min(found)))


def _nudges(gap: Gap, effect: Effect) -> list[Columns]:
    """Change of torque with each shape of an effect, per range of the shape."""
    blocks: list[Columns] = []
    scale, gains = gap.scales[effect.joints[-1]], effect.gain_values
    now = gap.columns(effect)
    for shape in (s.scaled(scale) for s in effect.shapes):
        step = _NUDGE * (shape.upper - shape.lower)
        value = effect.values[shape.name]
        if value + step > shape.upper:
            step = -step
        then = gap.columns(effect.at({shape.name: value + step}))
        size = _NUDGE if step > 0 else -_NUDGE
        blocks.append({j: ((then[j] - now[j]) @ gains / size)[:, None] for j in now})
    return blocks


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
