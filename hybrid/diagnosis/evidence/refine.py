"""Fit of the shapes of a candidate, and of gains in which it is not linear."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid.arrays import Index
from hybrid.diagnosis.evidence.candidates import (
    Candidate,
    gain_grid,
    scale_of,
    with_gains,
)
from hybrid.diagnosis.evidence.evidence import Evidence, Trial
from hybrid.diagnosis.evidence.shapes import fit_shapes, price, shape_derivatives
from hybrid.effects import Effect

_EXACT_PASSES = 4  # of a linearisation at the last gains
_SHAPE_STD = 0.3  # prior standard deviation of a shape, of its range
_SHORTER, _LONGER = 0.5, 2.0  # factors of a time shift that is searched
_SHIFTS, _SCAN, _FINE = 15, 12, 0.003  # evaluations; tolerance of a time and a gain


def refine(evidence: Evidence, base: Index, c: Candidate) -> tuple[Candidate, float]:
    """Fit the shapes of a candidate beside a base, near its own.

    Returns:
        The candidate with fitted shapes, and the log evidence that it adds, [nat].
    """

    def worth(effect: Effect) -> float:
        return gain(evidence, base, c.at(effect))

    first = scan_gain(evidence, base, c).effect if c.effect.steep else c.effect
    start = worth(first)
    effect, best = fit_shapes(first, worth, evidence.gap)
    if best < start:
        effect, best = first, start
    if effect.linearised:
        effect, best = _fit_nonlinear(evidence, base, c.at(effect))
    better = c.at(effect)
    factor = _trial(evidence, base, better).prior_factor
    return replace(better, prior_factor=factor), best


def gain(evidence: Evidence, base: Index, c: Candidate) -> float:
    """Log evidence that a candidate adds, less the price of its shapes, [nat]."""
    return _trial(evidence, base, c).worth - price(c.effect)


def _trial(evidence: Evidence, base: Index, c: Candidate) -> Trial:
    columns, fixed = evidence.gap.columns(c.effect), c.fixed_gains(evidence.gap)
    return evidence.trial(base, columns, c.std, c.lower, fixed)


def _fit_nonlinear(
    evidence: Evidence, base: Index, c: Candidate
) -> tuple[Effect, float]:
    """Fit the gains of an effect on signals, which is not linear in them."""
    effect, best, scale = c.effect, -np.inf, scale_of(evidence.gap, c.effect)
    bounds = [g.scaled(scale) for g in effect.gains]
    lower, upper = [b.lower for b in bounds], [b.upper for b in bounds]
    for _ in range(_EXACT_PASSES):
        columns = evidence.gap.columns(effect)
        best, gains, _ = evidence.trial(base, columns, c.std, c.lower)
        effect = with_gains(effect, np.clip(gains, lower, upper))
    if not effect.shifts:
        return effect, best - price(effect)
    effect = fit_shift(evidence, base, effect)
    return effect, gain(evidence, base, c.at(effect))


def fit_shift(
    evidence: Evidence, base: Index, effect: Effect, *, lower_band: bool | None = None
) -> Effect:
    """Fit the time of an effect that shifts torque, near its own.

    A free gain of its columns would be too small by noise, as if the time were shorter.
    For ``lower_band`` see :meth:`.Gap.columns`.
    """
    (own,), (now,) = effect.gains, effect.gain_values
    name, bounds = own.name, own.scaled(scale_of(evidence.gap, effect))

    def loss(time: float) -> float:
        columns = evidence.gap.columns(effect.at({name: time}), lower_band=lower_band)
        return -evidence.log_likelihood(base, columns, np.array([time]))

    ends = sorted([_SHORTER * now, _LONGER * now])
    ends = np.clip(ends, bounds.lower, bounds.upper)
    found = minimize_scalar(
        loss,
        bounds=(float(ends[0]), float(ends[1])),
        method="bounded",
        options={"maxiter": _SHIFTS, "xatol": _FINE * abs(now)},
    )
    return effect.at({name: float(found.x)})


def scan_gain(evidence: Evidence, base: Index, c: Candidate) -> Candidate:
    """A steep effect with the best gain, from one value of the grid to the other.

    Above the visible band its torque is proportional to the gain.
    """
    (own,), (now,), gap = c.effect.gains, c.effect.gain_values, evidence.gap
    bounds = own.scaled(scale_of(gap, c.effect))
    below, above, *_ = np.log(gain_grid(bounds))

    def at(log: float) -> Candidate:
        value = float(np.clip(now * np.exp(log), bounds.lower, bounds.upper))
        return c.at(c.effect.at({own.name: value}))

    found = minimize_scalar(
        lambda x: -gain(evidence, base, at(x)),
        bounds=(below - above, above - below),
        method="bounded",
        options={"maxiter": _SCAN, "xatol": _FINE},
    )
    best = at(found.x)
    if not gap.is_above_band(best.effect):
        return best
    (value,) = evidence.trial(base, gap.columns(best.effect), c.std, c.lower).gains
    value = float(np.clip(value, bounds.lower, bounds.upper))
    return c.at(best.effect.at({own.name: value}))


def add_shape_derivatives(evidence: Evidence, effect: Effect) -> Index:
    """Add the derivative of an effect's torque to each normalised shape, (s,)."""
    blocks = shape_derivatives(evidence.gap, effect)
    if not blocks:
        return np.zeros(0, dtype=np.intp)
    return np.concatenate(evidence.add(blocks, [np.array([_SHAPE_STD])] * len(blocks)))
