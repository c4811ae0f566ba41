"""The numbers that are reported, and how far off they may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2, qmc

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Candidate, with_gains
from hybrid.diagnosis.evidence.evidence import Evidence, Solution
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.refine import shifted, take_nudges
from hybrid.diagnosis.evidence.shapes import at_places, places, shape_units
from hybrid.diagnosis.explanations.elsewhere import Elsewhere
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect

_NORMAL = 1.96
_OPEN = 10.0  # times a gain's prior deviation
_DRAWS = 64  # shapes from all of the range, and as many from near the best
_WIDER = 2.0  # times the deviation, to draw from


def solve_all(gap: Gap, search: Search) -> tuple[Evidence, Solution, tuple[Index, ...]]:
    """Background and terms of a search, of shapes as they are, on all samples.

    Returns:
        The evidence, the gains of all columns, and the columns of each term.
    """
    every = Elsewhere(search, np.ones(len(gap.fold), dtype=bool))
    solution = every.evidence.solve(every.columns(search.causes))
    return every.evidence, solution, tuple(map(every.own, search.known))


def refit(gap: Gap, search: Search) -> tuple[Effect, ...]:
    """The effects of a search's terms, as all samples have them.

    Their standard deviations take into account that the others, and the numbers of the
    file, are not known exactly.
    """
    evidence, solution, own = solve_all(gap, search)
    index = solution.index
    effects = [
        with_gains(t.candidate.effect, solution.of(i))
        for t, i in zip(search.terms, own, strict=True)
    ]
    # The band's upper half tells the time best, if it is a shift for sure.
    effects = [
        shifted(evidence, np.setdiff1d(index, i), effect, calm=False)
        if effect.shifts else effect
        for effect, i in zip(effects, own, strict=True)
    ]  # fmt: skip
    shapes = [take_nudges(evidence, effect) for effect in effects]
    # How far the file's numbers are off was chosen by the same data.
    evidence.spread(index[: len(search.numbers)], search.widest)
    for i in own:
        # Values lean on their priors; what the data leave open the intervals show.
        evidence.spread(i, _OPEN)
    whole = evidence.solve(np.concatenate([index, *shapes]))
    place = {int(k): i for i, k in enumerate(whole.index)}
    certain = []
    for t, effect, i, s in zip(search.terms, effects, own, shapes, strict=True):
        here = [place[int(k)] for k in (*i, *s)]
        known = whole.covariance[np.ix_(here, here)]
        unit = np.array([*np.ones(len(i)), *shape_units(gap, effect)])
        covariance = known * np.outer(unit, unit)
        if len(s) and not effect.steep and not effect.repeats:
            base = np.setdiff1d(index, i)
            part = known[len(i) :, len(i) :]
            far = _over_shapes(
                evidence, base, replace(t.candidate, effect=effect), part
            )
            more = np.maximum(far / _NORMAL / np.sqrt(np.diag(covariance)), 1.0)
            covariance *= np.outer(more, more)
        covariance[np.diag_indices(len(here))] += _besides(gap, effect)
        certain.append(_reported(effect, covariance))
    return tuple(certain)


def _over_shapes(
    evidence: Evidence, base: Index, c: Candidate, covariance: Array
) -> Array:
    """How far off values are at any shapes that fit nearly as well, shape (p,).

    Such shapes lie along curves, or far apart, of which the curvature at the best says
    nothing. They are drawn from all of their range and from near the best; those within
    their joint 95 % region count (likelihood ratio).

    Args:
        evidence: Cross-products of the gap.
        base: All columns but the term's own.
        c: The term with its values.
        covariance: Of its shapes, by the curvature, of their range, shape (s, s).

    Source: Venzon and Moolgavkar 1988, doi 10.2307/2347496 (profile likelihood).
    """
    gap, middle = evidence.gap, places(evidence.gap, c.effect)
    names = [x.name for x in (*c.effect.gains, *c.effect.shapes) if not x.whole]
    size = len(middle)
    wide = _WIDER**2 * covariance
    near = qmc.MultivariateNormalQMC(middle, wide, rng=0).random(_DRAWS)
    points = np.concatenate([[middle], near, qmc.Sobol(size, rng=0).random(_DRAWS)])
    worth, off = [], []
    for point in np.clip(points, 0.0, 1.0):
        effect = at_places(gap, c.effect, point)
        found, gains, _ = evidence.trial(base, gap.columns(effect), c.std, c.lower)
        values = with_gains(effect, gains).values
        worth.append(found)
        off.append([values[x] - c.effect.values[x] for x in names])
    inside = np.array(worth) > max(worth) - chi2.ppf(0.95, size) / 2
    return np.asarray(np.abs(np.array(off)[inside]).max(axis=0, initial=0.0))


def _besides(gap: Gap, effect: Effect) -> Array:
    """Variance of values by what the law leaves out, shape (p,).

    And of a time at which something happens between two samples.
    """
    gains = list(effect.gains)
    shapes = [x for x in effect.shapes if not x.whole]
    law = [effect.inexact.get(x.name, 0.0) for x in (*gains, *shapes)]
    size = [effect.values[x.name] for x in (*gains, *shapes)]
    step = 1.0 / gap.motions[0].rate
    times = [step**2 / 12.0 if x.unit == "s" else 0.0 for x in shapes]
    return np.asarray(np.square(law) * np.square(size) + np.pad(times, (len(gains), 0)))


def _reported(effect: Effect, covariance: Array) -> Effect:
    """An effect's law of the torque reported, with standard deviations."""
    names = [x.name for x in (*effect.gains, *effect.shapes) if not x.whole]
    law = effect.as_reported()
    if law is effect:
        std = np.sqrt(np.diag(covariance))
        return law.at({}, dict(zip(names, map(float, std), strict=True)))
    slopes = []
    for name, spread in zip(names, np.sqrt(np.diag(covariance)), strict=True):
        step = 1e-4 * float(spread) or 1e-9
        then = effect.at({name: effect.values[name] + step}).as_reported()
        slopes.append([(then.values[x] - law.values[x]) / step for x in names])
    J = np.array(slopes).T
    std = np.sqrt(np.diag(J @ covariance @ J.T))
    return law.at({}, dict(zip(names, map(float, std), strict=True)))
