"""What noise is: what no explanation of a gap removes on samples left out."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import quiet
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise import LAGS, autocovariance
from hybrid.diagnosis.evidence.products import Index
from hybrid.signals import autocorrelation_time

_EXACT = 0.002  # of the torque: nearer than that no two solvers are
_LESS = 0.9  # of a variance: what is worth another search
# For columns of unit length.
_RIDGES = 10.0 ** np.arange(-5, 5)


def estimate_noise(evidence: Evidence, index: Index) -> None:
    """Noise of each joint: what all columns together miss on folds left out.

    The variance counts as often as the residual is alike in a row: the weights then
    belong to independent samples. It is never less than what the integration of the
    same model by other steps is off by.

    Args:
        evidence: Cross-products of a gap, whose noise is set.
        index: Columns.
    """
    for i, row in enumerate(evidence.rows):
        if not len(row):
            continue
        back = np.argsort(row)
        left, noise, least = _flexible(evidence, i, index)
        found = [(noise, left, row[back])]
        # A few events may be all of that, and spoil the regression as well.
        for x in (left, evidence.left[i][back]):
            calm = quiet(x, row[back], evidence.gap.rate)
            if not calm.all():
                usual = autocorrelation_time(x[calm], row[back][calm]) * np.mean(
                    x[calm] ** 2
                )
                found.append((float(usual), x[calm], row[back][calm]))
        noise, x, own = min(found, key=lambda x: x[0])
        evidence.noise[i] = max(noise, _least_noise(evidence, i, least))
        covariance = autocovariance(x, own, LAGS)
        covariance *= noise / max(autocorrelation_time(x, own) * covariance[0], 1e-300)
        evidence.covariances[i] = covariance


def lower_noise(evidence: Evidence, measured: Array, index: Index) -> Array:
    """Take what some columns leave for noise where it is less than that so far.

    Args:
        evidence: Cross-products of a gap, whose covariances are set.
        measured: Noise of each joint so far, shape (n,), [N²·m²].
        index: Columns of an explanation.

    Returns:
        Noise of each joint now, shape (n,), [N²·m²].
    """
    found, noise = evidence.solve(index), measured.copy()
    for i, row in enumerate(evidence.rows):
        if not len(row):
            continue
        back = np.argsort(row)
        left = evidence.residual(i, found.index, found.gains)[back]
        taken = len(evidence.known(index, i)[0])
        left /= max(1.0 - taken / _dimensions(evidence, i), 1e-3)
        alike = autocorrelation_time(left, row[back])
        power = float(left @ left) / len(row)
        if power < _LESS * evidence.covariances[i][0]:
            noise[i] = max(power * alike, _least_noise(evidence, i, alike))
            evidence.covariances[i] = autocovariance(left, row[back], LAGS)
    return noise


def _dimensions(evidence: Evidence, i: int) -> float:
    """Of a joint's samples: filtered noise has fewer than samples."""
    band = min(2.0 * evidence.gap.cutoff / evidence.gap.rate, 1.0)
    return max(len(evidence.rows[i]) * band, 1.0)


def _least_noise(evidence: Evidence, i: int, alike: float) -> float:
    torque = evidence.gap.measured[evidence.rows[i], i]
    return max(_EXACT**2 * float(np.mean(torque**2)) * alike, 1e-12)


def _flexible(evidence: Evidence, i: int, index: Index) -> tuple[Array, float, float]:
    """Ridge regression of a joint's gap on many columns, by the best ridge.

    Args:
        evidence: Cross-products of a gap.
        i: Joint.
        index: Columns.

    Returns:
        What it leaves in time, larger by what so many columns take from noise alone,
        shape (R,); the mean square that it leaves on each fold if fitted to the others,
        times the memory of what it leaves, [N²·m²]; and that memory.

    Source: Golub, Heath, Wahba 1979, doi 10.1080/00401706.1979.10489751 (what a ridge
    takes from noise).
    """
    columns, gap = evidence.own(i, index), evidence.left[i]
    parts = [(columns[:, a:b], gap[a:b]) for a, b in evidence.parts(i)]
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
        alike = autocorrelation_time(left, row)
        found.append((left, (gap @ gap + power) / len(row) * alike, alike, ridge))
    left, noise, alike, ridge = min(found, key=lambda x: x[1])
    kept = ridge * np.trace(_ridge(A, np.eye(len(A)), ridge))
    taken = (len(A) - kept) / _dimensions(evidence, i)
    return left / max(1.0 - taken, 1e-3), noise, alike


def _ridge(A: Array, b: Array, ridge: float) -> Array:
    """Weights of a ridge regression; overwrites the normal matrix."""
    A.flat[:: len(A) + 1] += ridge
    # Its transpose is in the order that LAPACK works in, so that nothing is copied.
    factor = cho_factor(A.T, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(cho_solve(factor, b, check_finite=False))
