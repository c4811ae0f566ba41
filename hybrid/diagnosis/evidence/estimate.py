"""The noise of the evidence: estimates of it, and errors of laws and simulators.

It is estimated by the residual of a flexible regression on held-out samples, or of an
explanation where that is smaller.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise import (
    LAGS,
    autocovariance,
    floored,
    without_events,
)
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.prior import Prior
from hybrid.signals import autocorrelation_time

_LESS = 0.9  # of a variance: a fall that is worth another search
_RIDGES = 10.0 ** np.arange(-5, 5)  # for columns of unit length


def estimate_noise(evidence: Evidence, index: Index) -> None:
    """Estimate the noise of each joint by cross-validation of many columns.

    The variance is multiplied by the residual's memory, so that it holds for samples
    that count as independent. It is not below the difference of two simulators.
    """
    for i, row in enumerate(evidence.rows):
        if not len(row):
            continue
        back = np.argsort(row)
        left, noise, least = _flexible(evidence, i, index)
        found = [(noise, left, row[back])]
        # A few events may dominate the residual, and spoil the regression.
        for x in (left, evidence.left[i][back]):
            use = without_events(x, row[back], evidence.gap.rate)
            if not use.all():
                usual = autocorrelation_time(x[use], row[back][use]) * np.mean(
                    x[use] ** 2
                )
                found.append((float(usual), x[use], row[back][use]))
        noise, x, own = min(found, key=lambda x: x[0])
        evidence.noise[i] = max(noise, _least_noise(evidence, i, least))
        covariance = autocovariance(x, own, LAGS)
        covariance *= noise / max(autocorrelation_time(x, own) * covariance[0], 1e-300)
        evidence.covariances[i] = covariance


def lower_noise(
    evidence: Evidence,
    measured: Array,
    law_errors: Array,
    rigid: Index,
    index: Index,
) -> tuple[Array, Array]:
    """Lower noise and errors of laws where the residual of an explanation is smaller.

    Noise and errors of laws together are not above that residual.

    Args:
        evidence: Cross-products of a gap, whose covariances are set.
        measured: Noise of each joint before, shape (n,), [N²·m²].
        law_errors: RMS error of laws over that of the gap before, shape (n,).
        rigid: Columns of the background.
        index: Columns of the explanation.

    Returns:
        Noise and errors of laws of each joint after, shape (n,) each.
    """
    noise, errors = measured.copy(), law_errors.copy()
    gaps, residuals = evidence.residuals(rigid), evidence.residuals(index)
    for i, row in enumerate(evidence.rows):
        if not len(row):
            continue
        back = np.argsort(row)
        left = residuals[i][back]
        fitted = len(evidence.base_columns(index, i)[0])
        left /= max(1.0 - fitted / _dimensions(evidence, i), 1e-3)
        lasts = autocorrelation_time(left, row[back])
        power, gap = float(left @ left) / len(row), float(np.mean(gaps[i] ** 2))
        if power < _LESS * evidence.covariances[i][0]:
            noise[i] = max(power * lasts, _least_noise(evidence, i, lasts))
            evidence.covariances[i] = autocovariance(left, row[back], LAGS)
        if power < _LESS * (evidence.covariances[i][0] + errors[i] ** 2 * gap):
            more = max(power - evidence.covariances[i][0], 0.0)
            errors[i] = np.sqrt(more / max(gap, 1e-300))
    return noise, errors


def set_noise_model(
    evidence: Evidence,
    measured: Array,
    law_errors: Array,
    rigid: Index,
    prior: Prior,
) -> list[Array]:
    """Set the noise of the evidence to measured noise plus model errors.

    The errors of laws are a part of the gap, and have its autocovariance; those of
    simulators are a part of the torque.

    ``measured`` is the noise variance of each joint, shape (n,), [N²·m²], ``law_errors``
    the RMS error of laws over that of the gap, shape (n,), and ``rigid`` are the columns
    of the background.

    Returns:
        Covariance of each joint's noise at lags from zero on, shape (p + 1,) each.
    """
    residuals, gap = evidence.residuals(rigid), evidence.gap
    evidence.noise, covariances = measured.copy(), list[Array]()
    for i, rows in enumerate(evidence.rows):
        covariance = evidence.covariances[i].copy()
        if len(rows):
            back = np.argsort(rows)
            left = residuals[i][back]
            torque = gap.measured[rows[back], i]
            torque -= np.mean(torque)
            solver = prior.solver_error**2 * np.mean(torque**2)
            solver *= autocorrelation_time(torque, rows[back])
            law = law_errors[i] ** 2 * autocovariance(left, rows[back], LAGS)
            evidence.noise[i] += solver + law[0] * autocorrelation_time(
                left, rows[back]
            )
            if gap.subtracted is not None:
                known, part = gap.subtracted[rows[back], i], prior.real_law_error**2
                law += part * autocovariance(known, rows[back], LAGS)
                evidence.noise[i] += (
                    part * np.mean(known**2) * autocorrelation_time(known, rows[back])
                )
            covariance += law
            covariance[0] += law[0] + solver
        covariances.append(floored(covariance, gap.cutoff / gap.rate))
    evidence.set_covariances(covariances)
    return covariances


def _dimensions(evidence: Evidence, i: int) -> float:
    """Degrees of freedom of a joint's filtered samples."""
    band = min(2.0 * evidence.gap.cutoff / evidence.gap.rate, 1.0)
    return max(len(evidence.rows[i]) * band, 1.0)


def _least_noise(evidence: Evidence, i: int, lasts: float) -> float:
    """Variance of the difference of two simulators, times a memory."""
    torque = evidence.gap.measured[evidence.rows[i], i]
    return max(Prior.solver_error**2 * float(np.mean(torque**2)) * lasts, 1e-12)


def _flexible(evidence: Evidence, i: int, index: Index) -> tuple[Array, float, float]:
    """Cross-validated ridge regression of a joint's gap on many columns.

    Returns:
        The residual in time order, corrected for the degrees of freedom of the fit,
        shape (R,); the cross-validated mean square times the residual's memory,
        [N²·m²]; and that memory.

    Source: Golub, Heath, Wahba 1979, doi 10.1080/00401706.1979.10489751 (degrees of
    freedom of a ridge regression).
    """
    columns, gap = evidence.columns_at(i, index), evidence.left[i]
    parts = [(columns[:, a:b], gap[a:b]) for a, b in evidence.fold_edges(i)]
    G = np.array([x @ x.T for x, _ in parts])
    c = np.array([x @ y for x, y in parts])
    size = np.sqrt(np.maximum(np.diagonal(G.sum(axis=0)), 1e-300))
    G, c = G / size / size[:, None], c / size
    A, b, folds = G.sum(axis=0), c.sum(axis=0), list(zip(G, c, strict=True))
    back, found = np.argsort(evidence.rows[i]), []
    row = evidence.rows[i][back]
    for ridge in _RIDGES:
        w = np.array([_ridge(A - g, b - x, ridge) for g, x in folds])
        power = np.einsum("fk,fk->", w, (G @ w[..., None])[..., 0] - 2 * c)
        left = (gap - (_ridge(A.copy(), b, ridge) / size) @ columns)[back]
        lasts = autocorrelation_time(left, row)
        found.append((left, (gap @ gap + power) / len(row) * lasts, lasts, ridge))
    left, noise, lasts, ridge = min(found, key=lambda x: x[1])
    free = ridge * np.trace(_ridge(A, np.eye(len(A)), ridge))
    fitted = (len(A) - free) / _dimensions(evidence, i)
    return left / max(1.0 - fitted, 1e-3), noise, lasts


def _ridge(A: Array, b: Array, ridge: float) -> Array:
    """Gains of a ridge regression; overwrites the normal matrix."""
    A.flat[:: len(A) + 1] += ridge
    # LAPACK works on the transpose without a copy.
    factor = cho_factor(A.T, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(cho_solve(factor, b, check_finite=False))
