"""The noise of the evidence: estimates of it, and errors of laws and simulators.

It is estimated by the residual of a flexible regression on held-out samples, or of an
explanation where that is smaller.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.evidence import Evidence, Solution
from hybrid.diagnosis.evidence.noise import (
    LAGS,
    autocovariance,
    floored,
    whitened_power,
    without_events,
)
from hybrid.diagnosis.prior import Prior
from hybrid.regression.least_squares import unit_columns
from hybrid.signals import autocorrelation_time

_LESS = 0.9  # of a variance: a fall that is worth another search
_RIDGES = 100.0 ** np.arange(-2, 3)  # for columns of unit length


class NoiseModel:
    """Noise of each joint plus the errors of laws and simulators.

    The errors of laws are a part of the gap in each recording, and have the gap's
    autocovariance; those of simulators are a part of the torque. Noise and errors of
    laws together are at most what an explanation leaves.

    Args:
        evidence: Cross-products of a gap, whose noise is estimated.

    Attributes:
        measured: Noise variance of each joint, shape (n,), [N²·m²].
        law_errors: RMS error of laws over that of the gap, shape (n,).
        covariances: Covariance of each joint's noise and errors at lags from zero on,
            shape (p + 1,) each.
        sizes: RMS noise and errors of each sample over the usual one, shape (M, n).
    """

    def __init__(self, evidence: Evidence, prior: Prior) -> None:
        self._evidence, self._prior = evidence, prior
        self.measured = evidence.noise.copy()
        self.law_errors = np.full(len(evidence.rows), prior.law_error)
        self.covariances: list[Array] = []
        self.sizes = np.ones(evidence.gap.left.shape)
        # Expected sum of whitened squares, and the part of it from errors, shape (n,).
        self._expected, self._errors = np.zeros((2, len(evidence.rows)))

    def lower(self, rigid: Index, index: Index) -> bool:
        """Lower noise and errors where an explanation leaves less; whether it does.

        What it leaves are squares of the fit and of its cross-validation, in geometric
        mean: gains that fit noise divide the one by what they multiply the other with.
        Squares of the fit alone would fall ever more, as a joint with less noise weighs
        more, at the cost of the others.

        Args:
            rigid: Columns of the background.
            index: Columns of the explanation.
        """
        evidence, lower = self._evidence, False
        gaps, residuals = evidence.residuals(rigid), evidence.residuals(index)
        unseen = evidence.held_out_residuals(index)
        for i, row in enumerate(evidence.rows):
            if not len(row):
                continue
            back = np.argsort(row)
            left = residuals[i][back]
            power, other, gap = (
                float(np.mean(x**2)) for x in (left, unseen[i], gaps[i])
            )
            left *= (other / max(power, 1e-300)) ** 0.25
            power = float(np.sqrt(power * other))
            if power < _LESS * evidence.covariances[i][0]:
                lasts = autocorrelation_time(left, row[back])
                least = _least_noise(evidence, i, lasts)
                self.measured[i] = max(power * lasts, least)
                evidence.covariances[i] = autocovariance(left, row[back], LAGS)
                lower = True
            noise, law = evidence.covariances[i][0], self.law_errors[i] ** 2 * gap
            if power < _LESS * (noise + law):
                self.law_errors[i] = np.sqrt(max(power - noise, 0.0) / gap)
                lower = True
        return lower

    def gain_if_lower(self, found: Solution) -> float:
        """Log likelihood that a solution gains if the noise is lower, [nat].

        The estimate of the noise is an upper bound. With the most probable noise of a
        joint each sample that determines no gain leaves a square of one. Errors of laws
        and simulators stay as they are.

        Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415, section 4.2.
        """
        evidence, gained = self._evidence, 0.0
        for i, (whole, errors) in enumerate(
            zip(self._expected, self._errors, strict=True)
        ):
            known = evidence.left_squares(found, i)
            if known >= whole or errors <= 0.0:
                continue
            free = max(whole - evidence.determined(found, i), 1.0)
            part = min(max(known / free, errors), 1.0)
            gained -= free * np.log(part) + known * (1.0 / part - 1.0)
        return float(gained) / 2

    def apply(self, rigid: Index) -> None:
        """Set the noise of the evidence; ``rigid`` are columns of the background."""
        evidence, gap = self._evidence, self._evidence.gap
        residuals = evidence.residuals(rigid)
        evidence.noise, covariances = self.measured.copy(), list[Array]()
        band = gap.cutoff / gap.rate
        for i, rows in enumerate(evidence.rows):
            noise = evidence.covariances[i]
            whole = noise.copy()
            if len(rows):
                row = np.sort(rows)
                left = residuals[i][np.argsort(rows)]
                variance, law = self._law_error(left, row, self.law_errors[i])
                more = law[0] * self._excess(gap.left, i)
                if gap.subtracted is not None:
                    known, part = gap.subtracted, self._prior.real_law_error
                    own = self._law_error(known[row, i], row, part)
                    variance, law = variance + own[0], law + own[1]
                    more += own[1][0] * self._excess(known, i)
                torque = gap.measured[row, i]
                torque -= np.mean(torque)
                solver = self._prior.solver_error**2 * np.mean(torque**2)
                solver *= autocorrelation_time(torque, row)
                evidence.noise[i] += variance + solver
                whole += law
                whole[0] += law[0] + solver
                # The noise of the band is in all bands: errors count twice.
                self.sizes[:, i] = np.sqrt(1.0 + 2.0 * more / max(whole[0], 1e-300))
            covariance = floored(whole, band)
            power = whitened_power(covariance, whole)
            alone = whitened_power(covariance, floored(noise, band))
            self._expected[i] = evidence.count[i] * power
            self._errors[i] = (1.0 - alone) / power
            covariances.append(covariance)
        self.covariances = covariances
        evidence.set_covariances(covariances, self.sizes)

    def _excess(self, torque: Array, i: int) -> Array:
        """Power of a joint's torque in a sample's recording over the usual, less one.

        The usual one is that of the evidence's samples; shape (M,).
        """
        gap, rows = self._evidence.gap, self._evidence.rows[i]
        squares, use = torque[:, i] ** 2, gap.moving[:, i]
        count = np.bincount(gap.trajectory, use)
        power = np.bincount(gap.trajectory, squares * use) / np.maximum(count, 1.0)
        power /= max(float(squares[rows].mean()), 1e-300)
        return np.where(count > 0, power - 1.0, 0.0)[gap.trajectory]

    @staticmethod
    def _law_error(torque: Array, row: Index, part: float) -> tuple[float, Array]:
        """Noise and covariance of errors that are a part of some torque."""
        covariance = part**2 * autocovariance(torque, row, LAGS)
        return float(covariance[0] * autocorrelation_time(torque, row)), covariance


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
    columns, gap = evidence.base_columns(index, i)[1], evidence.left[i]
    parts = [(columns[:, a:b], gap[a:b]) for a, b in evidence.fold_edges(i)]
    G = np.array([x @ x.T for x, _ in parts])
    c = np.array([x @ y for x, y in parts])
    size = unit_columns(G.sum(axis=0))[1]
    G /= np.outer(size, size)
    c /= size
    A, b, folds = G.sum(axis=0), c.sum(axis=0), list(zip(G, c, strict=True))
    back, found = np.argsort(evidence.rows[i]), []
    row = evidence.rows[i][back]
    every = np.array([_ridge(A.copy(), b, ridge) for ridge in _RIDGES]) / size
    lefts = (gap - every @ columns)[:, back]
    for ridge, left in zip(_RIDGES, lefts, strict=True):
        w = np.array([_ridge(A - g, b - x, ridge) for g, x in folds])
        power = np.einsum("fk,fk->", w, (G @ w[..., None])[..., 0] - 2 * c)
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
