"""The reported values of effects, with their standard deviations."""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.candidates import Candidate, delivered, with_gains
from hybrid.diagnosis.evidence.evidence import Evidence, Solution
from hybrid.diagnosis.evidence.noise import LAGS, autocovariance, floored
from hybrid.diagnosis.evidence.refine import add_shape_derivatives, fit_shift
from hybrid.diagnosis.evidence.shapes import (
    normalised_shapes,
    shape_units,
    with_normalised_shapes,
)
from hybrid.diagnosis.explanations.other_samples import OtherSamples
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect
from hybrid.statistics import HALF_WIDTH

_OPEN = 10.0  # factor on the priors of gains, so that intervals show the data
_DRAWS = 64  # shapes from the whole range, and as many from near the best
_WIDER = 2.0  # factor on the standard deviation of the draws near the best


def solve_all(search: Search) -> tuple[Evidence, Solution, tuple[Index, ...]]:
    """Fit background and terms of a search, with their shapes, to all samples.

    Returns:
        The evidence, the gains of all columns, and the columns of each term.
    """
    every = OtherSamples(search, np.ones(len(search.gap.fold), dtype=bool))
    solution = every.evidence.solve(every.columns(search.causes))
    return every.evidence, solution, tuple(map(every.own, search.known))


def refit(search: Search) -> tuple[Effect, ...]:
    """Effects of a search's terms, fitted to all samples, on the delivered torque.

    Their standard deviations include the uncertainty of all other terms, and of the
    file's numbers.
    """
    evidence, solution, own = solve_all(search)
    gap, index = search.gap, solution.index
    effects = [
        t.candidate.fitted(solution.of(i))
        for t, i in zip(search.terms, own, strict=True)
    ]
    # The upper half of the band determines the time of a shift best.
    effects = [
        fit_shift(evidence, np.setdiff1d(index, i), effect, lower_band=False)
        if effect.shifts else effect
        for effect, i in zip(effects, own, strict=True)
    ]  # fmt: skip
    shapes = [add_shape_derivatives(evidence, effect) for effect in effects]
    _set_noise_of_residual(evidence, solution)
    # The error of the file's numbers was chosen by the same data.
    numbers = index[: len(search.numbers)]
    evidence.scale_prior(numbers, search.reported_file_error)
    for i in own:
        evidence.scale_prior(i, _OPEN)
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
            own_candidate = replace(t.candidate, effect=effect)
            far = _profile_range(evidence, base, own_candidate, part)
            more = np.maximum(far / HALF_WIDTH / np.sqrt(np.diag(covariance)), 1.0)
            covariance *= np.outer(more, more)
        covariance[np.diag_indices(len(here))] += _model_variance(gap, effect)
        certain.append(_reported(gap, effect, covariance))
    return delivered(certain)


def _set_noise_of_residual(evidence: Evidence, solution: Solution) -> None:
    """Set the noise to what a solution leaves, as an interval refers to that.

    In a search the errors of laws and simulators in general count as noise as well.
    """
    gap, covariances = evidence.gap, list[Array]()
    for i, rows in enumerate(evidence.rows):
        back = np.argsort(rows)
        left = evidence.residual(i, solution.index, solution.gains)[back]
        known = autocovariance(left, rows[back], LAGS) if len(rows) else np.ones(1)
        covariances.append(floored(known, gap.cutoff / gap.rate))
    evidence.set_covariances(covariances)


def _profile_range(
    evidence: Evidence, base: Index, c: Candidate, covariance: Array
) -> Array:
    """Largest deviation of each value within the 95 % region of the shapes, (p,).

    The curvature at the optimum does not describe a curved or divided region. Shapes
    are drawn from the whole range and from near the optimum; the likelihood ratio tells
    which of them are in the region. ``covariance`` is that of the normalised shapes by
    the curvature, shape (s, s).

    Source: Venzon and Moolgavkar 1988, doi 10.2307/2347496 (profile likelihood).
    """
    gap, middle = evidence.gap, normalised_shapes(evidence.gap, c.effect)
    names, size = _names(gap, c.effect), len(middle)
    rng, wide = np.random.default_rng(0), _WIDER**2 * covariance
    near = rng.multivariate_normal(middle, wide, _DRAWS, check_valid="ignore")
    points = np.concatenate([[middle], near, rng.random((_DRAWS, size))])
    worth, off = [], []
    for point in np.clip(points, 0.0, 1.0):
        drawn = c.at(with_normalised_shapes(gap, c.effect, point))
        columns = gap.columns(drawn.effect)
        found, gains, _ = evidence.trial(base, columns, c.std, drawn.lower)
        values = with_gains(drawn.effect, gains).values
        worth.append(found)
        off.append([values[x] - c.effect.values[x] for x in names])
    inside = np.array(worth) > max(worth) - chdtri(size, 0.05) / 2
    return np.asarray(np.abs(np.array(off)[inside]).max(axis=0, initial=0.0))


def _model_variance(gap: Gap, effect: Effect) -> Array:
    """Variance of values by errors of the law, and of times by sampling, shape (p,)."""
    names = _names(gap, effect)
    law = [effect.inexact.get(x, 0.0) * effect.values[x] for x in names]
    shapes = [x for x in effect.shapes if x.name in names]
    times = [gap.period**2 / 12.0 if x.unit == "s" else 0.0 for x in shapes]
    return np.asarray(np.square(law) + np.pad(times, (len(effect.gains), 0)))


def _names(gap: Gap, effect: Effect) -> list[str]:
    """Names of the gains, and of the shapes that are fitted."""
    values = (*effect.gains, *effect.shapes_along(gap.motions))
    return [x.name for x in values if not x.whole]


def _reported(gap: Gap, effect: Effect, covariance: Array) -> Effect:
    """The effect as it is reported, with standard deviations (delta method)."""
    names, law = _names(gap, effect), effect.as_reported()
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
