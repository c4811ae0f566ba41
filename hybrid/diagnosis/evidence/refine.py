"""Fit of the shapes of a candidate, and of gains in which it is not linear."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid.arrays import Index
from hybrid.diagnosis.evidence.candidates import Candidate, scale_of, with_gains
from hybrid.diagnosis.evidence.evidence import Evidence, Trial
from hybrid.diagnosis.evidence.shapes import fit_shapes, price, shape_derivatives
from hybrid.effects import Effect

_EXACT_PASSES = 4  # of a linearisation at the last gains
_SHAPE_STD = 0.3  # prior standard deviation of a shape, of its range
_SHORTER, _LONGER = 0.5, 2.0  # factors of a time shift that is searched
_SHIFTS, _FINE = 15, 0.003  # evaluations; tolerance, as a part of the shift
_STEP, _SCAN = 1.15, 9  # factor to either side of a steep gain; evaluations


def refine(evidence: Evidence, base: Index, c: Candidate) -> tuple[Candidate, float]:
    """Fit the shapes of a candidate beside a base, near its own.

    Returns:
        The candidate with fitted shapes, and the log evidence that it adds, [nat].
    """

    def worth(effect: Effect) -> float:
        return gain(evidence, base, replace(c, effect=effect))

    first = _scan_gain(evidence, base, c, worth) if c.effect.steep else c.effect
    start = worth(first)
    effect, best = fit_shapes(first, worth, evidence.gap)
    if best < start:
        effect, best = first, start
    if effect.linearised:
        effect, best = _fit_nonlinear(evidence, base, replace(c, effect=effect))
    better = replace(c, effect=effect)
    factor = _trial(evidence, base, better).prior_factor
    return replace(better, prior_factor=factor), best


def gain(evidence: Evidence, base: Index, c: Candidate) -> float:
    """Log evidence that a candidate adds, less the price of its shapes, [nat]."""
    return _trial(evidence, base, c).worth - price(c.effect)


def _trial(evidence: Evidence, base: Index, c: Candidate) -> Trial:
    columns = evidence.gap.columns(c.effect)
    return evidence.trial(base, columns, c.std, c.lower, c.fixed_gains)


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
    return effect, gain(evidence, base, replace(c, effect=effect))


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


def _scan_gain(
    evidence: Evidence, base: Index, c: Candidate, worth: Callable[[Effect], float]
) -> Effect:
    """Fit the gain of a steep effect near its own.

    Above the visible band its torque is proportional to the gain.
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
    if not evidence.gap.is_above_band(best):
        return best
    columns = evidence.gap.columns(best)
    (gain,) = evidence.trial(base, columns, c.std, c.lower).gains
    return best.at({own.name: float(np.clip(gain, bounds.lower, bounds.upper))})


def add_shape_derivatives(evidence: Evidence, effect: Effect) -> Index:
    """Add the derivative of an effect's torque to each normalised shape, (s,)."""
    blocks = shape_derivatives(evidence.gap, effect)
    if not blocks:
        return np.zeros(0, dtype=np.intp)
    return np.concatenate(evidence.add(blocks, [np.array([_SHAPE_STD])] * len(blocks)))
