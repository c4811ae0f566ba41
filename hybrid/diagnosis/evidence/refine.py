"""Candidates at their best: shapes and gains in which their torque is not linear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid.diagnosis.evidence.candidates import Candidate, scale_of, with_gains
from hybrid.diagnosis.evidence.evidence import Evidence, Trial
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.shapes import fit_shapes, nudges, price
from hybrid.effects import Effect

_EXACT_PASSES = 4
_SHAPE_SPREAD = 0.3  # prior deviation of a shape, of its range
_SHORTER, _LONGER, _SHIFTS, _FINE = 0.5, 2.0, 15, 0.003  # factors; times tried; part
_STEP, _SCAN = 1.15, 9  # factor to either side of a steep gain; values tried


def refine(evidence: Evidence, base: Index, c: Candidate) -> tuple[Candidate, float]:
    """Fit the shapes of a candidate, from those given on.

    Args:
        evidence: Cross-products of the gap.
        base: Columns that are in already, shape (k,).
        c: The candidate.

    Returns:
        The candidate with better shapes, and the evidence that it adds, [nat].
    """

    def worth(effect: Effect) -> float:
        return gain(evidence, base, replace(c, effect=effect))

    first = _scanned(evidence, base, c, worth) if c.effect.steep else c.effect
    start = worth(first)
    effect, best = fit_shapes(first, worth, evidence.gap)
    if best < start:
        effect, best = first, start
    if effect.linearised:
        effect, best = _exact(evidence, base, replace(c, effect=effect))
    better = replace(c, effect=effect)
    return replace(better, wider=_tried(evidence, base, better).wider), best


def gain(evidence: Evidence, base: Index, c: Candidate) -> float:
    """Evidence that a candidate adds, less the price of its shapes, [nat]."""
    return _tried(evidence, base, c).worth - price(c.effect)


def _tried(evidence: Evidence, base: Index, c: Candidate) -> Trial:
    columns = evidence.gap.columns(c.effect)
    return evidence.trial(base, columns, c.std, c.lower, c.made_at)


def _exact(evidence: Evidence, base: Index, c: Candidate) -> tuple[Effect, float]:
    """An effect on signals at its own gains, where its columns are not linear."""
    effect, best, scale = c.effect, -np.inf, scale_of(evidence.gap, c.effect)
    bounds = [g.scaled(scale) for g in effect.gains]
    lower, upper = [b.lower for b in bounds], [b.upper for b in bounds]
    for _ in range(_EXACT_PASSES):
        columns = evidence.gap.columns(effect)
        best, gains, _ = evidence.trial(base, columns, c.std, c.lower)
        effect = with_gains(effect, np.clip(gains, lower, upper))
    if not effect.shifts:
        return effect, best - price(effect)
    effect = shifted(evidence, base, effect)
    return effect, gain(evidence, base, replace(c, effect=effect))


def shifted(
    evidence: Evidence, base: Index, effect: Effect, *, calm: bool | None = None
) -> Effect:
    """A shift by the time at which its own torque, and no part of it, fits best.

    Noise takes from the part that fits, which is not to be taken for a shorter time.

    Args:
        evidence: Cross-products of the gap.
        base: Columns that are in already, shape (k,).
        effect: The shift, by a time near the best.
        calm: See :meth:`.Gap.columns`.
    """
    (own,), (now,) = effect.gains, effect.gain_values
    name, bounds = own.name, own.scaled(scale_of(evidence.gap, effect))

    def loss(time: float) -> float:
        columns = evidence.gap.columns(effect.at({name: time}), calm=calm)
        return -evidence.at(base, columns, np.array([time]))

    ends = sorted([_SHORTER * now, _LONGER * now])
    ends = np.clip(ends, bounds.lower, bounds.upper)
    found = minimize_scalar(
        loss,
        bounds=(float(ends[0]), float(ends[1])),
        method="bounded",
        options={"maxiter": _SHIFTS, "xatol": _FINE * abs(now)},
    )
    return effect.at({name: float(found.x)})


def _scanned(
    evidence: Evidence, base: Index, c: Candidate, worth: Callable[[Effect], float]
) -> Effect:
    """A steep effect at the best gain near its own, which is on a fine grid.

    Where it only bends, and swings above the band, it is one in proportion to its gain.
    """
    (own,), (now,) = c.effect.gains, c.effect.gain_values
    bounds = own.scaled(scale_of(evidence.gap, c.effect))

    def at(power: float) -> Effect:
        value = float(np.clip(now * _STEP**power, bounds.lower, bounds.upper))
        return c.effect.at({own.name: value})

    found = minimize_scalar(
        lambda x: -worth(at(x)),
        bounds=(-1.0, 1.0),
        method="bounded",
        options={"maxiter": _SCAN, "xatol": 0.02},
    )
    best = at(found.x)
    if not evidence.gap.above(best):
        return best
    columns = evidence.gap.columns(best)
    (gain,) = evidence.trial(base, columns, c.std, c.lower).gains
    return best.at({own.name: float(np.clip(gain, bounds.lower, bounds.upper))})


def take_nudges(evidence: Evidence, effect: Effect) -> Index:
    """Take in the change of an effect's torque with each of its shapes.

    Args:
        evidence: Where the columns go.
        effect: The effect with its gains.

    Returns:
        The columns, one for each shape, shape (s,), per whole range of the shape.
    """
    blocks = nudges(evidence.gap, effect)
    if not blocks:
        return np.zeros(0, dtype=np.intp)
    spread = [np.array([_SHAPE_SPREAD])] * len(blocks)
    return np.concatenate(evidence.add(blocks, spread))
