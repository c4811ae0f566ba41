"""Nonlinear least squares on the identifiable parameters, without outliers.

Residuals are weighted by the noise of their kind of measurement, which is estimated as
well. A robust loss finds the scale of the noise, outliers are then rejected, and plain
least squares on the rest gives the estimates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from hybrid.arrays import Array, Index, Mask
from hybrid.calibration.covariance import clustered_covariance
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.model import Block, KinematicModel
from hybrid.calibration.outliers import misfit
from hybrid.dynamics.base import BaseParameters, base_parameters
from hybrid.errors import CalibrationError
from hybrid.statistics import robust_std

USUAL_NOISE = 1e-4  # m or rad, initial noise
LEAST_NOISE = 1e-9  # m or rad, smallest noise, above rounding errors
_ROUNDS, _ROBUST_ROUNDS = 20, 10  # of rejection and reweighting; of robust fits
_SETTLED = 0.02  # relative change of noise


@dataclass(frozen=True)
class Rejected:
    """An outlier: its pose, its kind, and the size of its residual, [m or rad]."""

    pose: int
    kind: str
    size: float


@dataclass(frozen=True)
class KinematicSolution:
    """Estimates of the identifiable parameters."""

    labels: tuple[str, ...]  # length b
    x: Array  # shape (b,), [m, rad, ...]
    covariance: Array  # shape (b, b), clustered by pose
    degrees: Array  # degrees of freedom of each estimate's variance, shape (b,)
    noise: dict[str, float]  # standard deviation of each kind, [m or rad]
    reduced: BaseParameters  # and how the other parameters relate to them
    jacobian: Array  # derivatives over noise at the estimate, shape (rows, b)
    rejected: tuple[Rejected, ...]
    iterations: int  # linearisations in all rounds
    evaluations: int  # of the model in all rounds
    converged: bool  # whether the last round met its tolerance

    @property
    def std(self) -> Array:
        """Standard deviation of each estimate, shape (b,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Confidence limits of the estimates, shape (b,) each."""
        half = stdtrit(self.degrees, (1 + level) / 2) * self.std
        return self.x - half, self.x + half

    def values(self) -> dict[str, float]:
        """Estimates by name."""
        return dict(zip(self.labels, self.x.tolist(), strict=True))


def solve(
    model: KinematicModel,
    data: Measurements,
    labels: Sequence[str],
    *,
    frames: int = 0,
    load: Array | None = None,
    robust: bool = True,
) -> KinematicSolution:
    """Estimate those of the labelled parameters that these poses identify.

    Of equivalent parameters, the first is estimated. The first ``frames`` labels place
    instrument and tool. They are fitted to the nominal arm first, because a tool on an
    axis would hide parameters. Joints have a ``load``, shape (N, n), [N·m].

    Raises:
        CalibrationError: There are not more measurements than parameters.
    """
    fit = _Fit(model, data, load)
    placed: dict[str, float] = {}
    if frames:
        fit.reduce(labels[:frames], placed)
        x = fit.minimise(np.zeros(len(fit.labels)))
        placed = dict(zip(fit.labels, x.tolist(), strict=True))
    reduced = fit.reduce(labels, placed)
    x = fit.minimise(np.array([placed.get(label, 0.0) for label in fit.labels]))
    if robust:
        x = fit.robust(x)
    for _ in range(_ROUNDS):
        settled = not robust or fit.reject(x)
        before = dict(fit.noise)
        x = fit.minimise(x)
        fit.estimate_noise(x)
        # With one kind of measurement, weights only scale the whole sum of squares.
        if settled and (len(before) == 1 or _change(before, fit.noise) < _SETTLED):
            break
    residual, jacobian, pose = fit.weighted(x)
    covariance, degrees = clustered_covariance(jacobian, residual, pose)
    return KinematicSolution(
        fit.labels, x, covariance, degrees, fit.noise, reduced, jacobian,
        tuple(fit.rejected), fit.iterations, fit.evaluations, fit.converged,
    )  # fmt: skip


def _change(before: Mapping[str, float], after: Mapping[str, float]) -> float:
    return max(abs(after[kind] / before[kind] - 1) for kind in before)


class _Fit:
    """Free parameters, noise of each kind of measurement, and what is rejected."""

    labels: tuple[str, ...]
    freedom: dict[str, float]  # degrees of freedom of each kind's noise
    kept: dict[str, Mask]  # units of each kind that are not rejected

    def __init__(
        self, model: KinematicModel, data: Measurements, load: Array | None
    ) -> None:
        self.model, self.data, self.load = model, data, load
        self.noise: dict[str, float] = {}
        self.rejected: list[Rejected] = []
        self.iterations = self.evaluations = self.rows = 0
        self.converged = False
        self._last: tuple[Array, list[Block]] | None = None

    def reduce(
        self, labels: Sequence[str], values: Mapping[str, float]
    ) -> BaseParameters:
        """Keep the parameters that are identifiable at these values; 0 if absent."""
        self.labels, self._last = tuple(labels), None
        x = np.array([values.get(label, 0.0) for label in labels])
        blocks = self.blocks(x)
        self.noise = {b.name: USUAL_NOISE for b in blocks}
        self.kept = {b.name: np.ones(len(b.pose), dtype=bool) for b in blocks}
        jacobian = self.weighted(x)[1]
        if not len(jacobian):
            raise CalibrationError(f"{self.data.source}: nothing was measured")
        units = tuple(self.model.units[label] for label in labels)
        reduced = base_parameters(jacobian, self.labels, units)
        self.rows = len(jacobian)
        if self.rows <= reduced.size:
            raise CalibrationError(
                f"{self.data.source}: {self.rows} numbers were measured in "
                f"{self.data.size} poses; valid are more than the {reduced.size} "
                "parameters to estimate"
            )
        share = 1 - reduced.size / self.rows
        self.freedom = {b.name: share * b.residual.size for b in blocks}
        self.labels, self._last = reduced.kept_labels, None
        return reduced

    def blocks(self, x: Array) -> list[Block]:
        """Residuals of all measurements; those of the last parameters are kept."""
        if self._last is None or not np.array_equal(x, self._last[0]):
            found = self.model.blocks(self.data, self.labels, x, self.load)
            self._last = (x.copy(), found)
            self.evaluations += 1
        return self._last[1]

    def weighted(self, x: Array) -> tuple[Array, Array, Index]:
        """Residuals and derivatives over noise, and the pose of each row."""
        rows = []
        for b in self.blocks(x):
            kept, noise = self.kept[b.name], self.noise[b.name]
            residual, jacobian = b.residual[kept] / noise, b.jacobian[kept] / noise
            pose = np.repeat(b.pose[kept], b.residual.shape[1])
            rows.append((residual.ravel(), jacobian.reshape(len(pose), len(x)), pose))
        residuals, jacobians, poses = map(np.concatenate, zip(*rows, strict=True))
        return residuals, jacobians, poses

    def minimise(
        self, x: Array, *, loss: Literal["linear", "cauchy"] = "linear"
    ) -> Array:
        """Weighted least squares from a first estimate."""

        def residual(x: Array) -> Array:
            return self.weighted(x)[0]

        def jacobian(x: Array) -> Array:
            return self.weighted(x)[1]

        plain = loss == "linear"
        result = least_squares(
            residual,
            x,
            jacobian,
            method="lm" if plain else "trf",
            loss=loss,
            x_scale="jac",
            xtol=1e-13 if plain else 1e-8,
            ftol=1e-15 if plain else 1e-8,
            gtol=1e-15,
        )
        self.iterations += int(result.njev or 0)
        self.converged = bool(result.success)
        return np.asarray(result.x)

    def robust(self, x: Array) -> Array:
        """Alternate between a robust fit and the scale of its residuals."""
        wider = np.sqrt(self.rows / (self.rows - len(x)))
        for _ in range(_ROBUST_ROUNDS):
            before = self.noise
            self.noise = {
                b.name: max(wider * float(robust_std(b.residual.ravel())), LEAST_NOISE)
                for b in self.blocks(x)
            }
            exact = max(self.noise.values()) == LEAST_NOISE
            if exact or _change(before, self.noise) < _SETTLED:
                break
            x = self.minimise(x, loss="cauchy")
        return x

    def reject(self, x: Array) -> bool:
        """Reject units that the others predict badly; True if nothing changed.

        The majority always stays, as in least trimmed squares.
        """
        before, rows = self.kept, sum(b.residual.size for b in self.blocks(x))
        root = np.linalg.inv(np.linalg.qr(self.weighted(x)[1], mode="r"))
        least = (rows + len(x) + 1) / 2 / rows
        self.kept, self.rejected = {}, []
        for b in self.blocks(x):
            noise, kept = self.noise[b.name], before[b.name]
            scaled = b.residual / noise, b.jacobian / noise
            ratio = misfit(*scaled, root @ root.T, kept, self.freedom[b.name])
            bound = max(1.0, float(np.quantile(ratio, least, method="higher")))
            self.kept[b.name] = ratio <= bound
            size = np.linalg.norm(b.residual, axis=1)
            self.rejected += [
                Rejected(int(b.pose[k]), b.name, float(size[k]))
                for k in np.flatnonzero(ratio > bound)
            ]
        return all(np.array_equal(before[kind], self.kept[kind]) for kind in before)

    def estimate_noise(self, x: Array) -> None:
        """Estimate the noise of each kind from its residuals and degrees of freedom."""
        Q = np.linalg.qr(self.weighted(x)[1])[0]
        row = 0
        for b in self.blocks(x):
            residual = b.residual[self.kept[b.name]].ravel()
            used = float((Q[row : row + len(residual)] ** 2).sum())
            row += len(residual)
            freedom = max(len(residual) - used, 1.0)
            self.freedom[b.name] = freedom
            noise = float(np.sqrt(residual @ residual / freedom))
            self.noise[b.name] = max(noise, LEAST_NOISE)
