"""The most probable servos: Gauss–Newton on replays, under priors from the file.

    J(x) = Σ_j 1/τ_j Σ_k ρ(e_jk / σ_j) + ½ Σ ((x − x_file) / s)²

e is what a replay misses of the measured position. Errors of a replay last: τ_j samples
count as one, their integrated autocorrelation. ρ is Cauchy's: a joint that runs against
something does not pull the rest. A servo moves its own joint before others: numbers of
one kind are changed at all joints at once, and each joint shows its own slope. The last
slopes, which the covariance needs, are made one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import QUANTITIES, Drive
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch

_FAR = 3.0  # σ beyond which an error counts less
_TURNS = 30  # Gauss–Newton steps
_ENDS = 2e-3  # relative fall of the cost that is not worth another
_DAMPINGS = (0.01, 0.1, 1.0, 10.0, 100.0)
_LARGEST = 1.0  # step of a logarithm; of other numbers in prior deviations
_PROBE = 0.05  # the same for slopes
_SAME = 1e-6  # rad: less is rounding
_UNTOLD = 0.7  # of the prior deviation
_LONGEST = 200  # samples of autocorrelation


@dataclass(frozen=True, eq=False)
class DriveEstimate:
    """Servos, and how sure they are.

    Attributes:
        drive: The servos.
        free: Which coordinates were fitted, (len(QUANTITIES), n), P of them.
        covariance: Of those, shape (P, P).
        sigma: Usual error of a replay at each joint, shape (n,), [rad].
        cost: Negative logarithm of their posterior, but for a constant.
    """

    drive: Drive
    free: NDArray[np.bool_]
    covariance: Array
    sigma: Array
    cost: float

    @property
    def std(self) -> Array:
        """Standard deviation of every coordinate, 0 of those not fitted, (…, n)."""
        std = np.zeros(self.free.shape)
        std[self.free] = np.sqrt(np.diagonal(self.covariance))
        return std

    def back(self, prior: Drive, k: int, j: int) -> Drive:
        """Servos with one number of the prior, the others making up for it.

        x' = x − C_i (x_i − f_i) / C_ii, the most probable others for small changes.

        Args:
            prior: Where the number is taken from.
            k: Index of the quantity.
            j: Index of the joint.
        """
        x, places = self.drive.coordinates, np.argwhere(self.free)
        i = int(np.flatnonzero((places == (k, j)).all(axis=1))[0])
        off = prior.coordinates[k, j] - x[k, j]
        x[self.free] += self.covariance[i] / self.covariance[i, i] * off
        return self.drive.moved(x)

    def keeping(self, prior: Drive, stays: NDArray[np.bool_]) -> DriveEstimate:
        """The same with all numbers of some joints, shape (n,), from the prior."""
        values = np.where(stays, prior.values, self.drive.values)
        left = ~stays[np.argwhere(self.free)[:, 1]]
        return replace(
            self,
            drive=replace(self.drive, values=values),
            free=self.free & ~stays,
            covariance=self.covariance[np.ix_(left, left)],
        )

    def without(self, prior: Drive, k: int, j: int) -> DriveEstimate:
        """The same with one number known to be the prior's."""
        places = np.argwhere(self.free)
        i = int(np.flatnonzero((places == (k, j)).all(axis=1))[0])
        row = self.covariance[i]
        covariance = self.covariance - np.outer(row, row) / row[i]
        rest = np.delete(np.delete(covariance, i, axis=0), i, axis=1)
        free = self.free.copy()
        free[k, j] = False
        drive = self.back(prior, k, j)
        return replace(self, drive=drive, free=free, covariance=rest)


class _Problem:
    def __init__(
        self,
        simulator: ServoSimulator,
        stretches: Sequence[Stretch],
        prior: Drive,
        free: NDArray[np.bool_],
        floor: Array,
    ) -> None:
        self.simulator, self.stretches, self.prior = simulator, stretches, prior
        self.free, self.floor = free, floor
        self.center, self.spread = prior.coordinates, prior.spread
        self.sigma, self.tau = np.full_like(floor, np.inf), np.ones_like(floor)

    def errors(self, drives: Sequence[Drive]) -> list[Array]:
        """What replays miss, shape (M, n) for each drive, [rad]."""
        found = self.simulator.replay(self.stretches, drives)
        pairs = [zip(own, self.stretches, strict=True) for own in found]
        return [np.concatenate([q - x.q for q, x in pair]) for pair in pairs]

    def weigh(self, errors: Array) -> None:
        """Take noise and its memory from errors."""
        most = _FAR * self.sigma
        clipped = np.clip(errors, -most, most)
        usual = np.sqrt(np.mean(clipped**2, axis=0))
        self.sigma = np.maximum(usual, self.floor)
        self.tau = np.array([_memory(x) for x in clipped.T])

    def cost(self, errors: Array, coordinates: Array) -> float:
        """Negative log posterior."""
        if not np.isfinite(errors).all():
            return np.inf
        z = (errors / self.sigma / _FAR) ** 2
        data = 0.5 * _FAR**2 * (np.log1p(z).sum(axis=0) / self.tau).sum()
        off = ((coordinates - self.center) / self.spread)[self.free]
        return float(data + 0.5 * off @ off)

    def normal(self, errors: Array, slopes: Array, x: Array) -> tuple[Array, Array]:
        """Matrix and gradient of the free coordinates; slopes (P, M, n)."""
        weight = 1.0 / (1.0 + (errors / self.sigma / _FAR) ** 2)
        weight /= self.sigma**2 * self.tau
        flat = slopes.reshape(len(slopes), -1)
        matrix = (flat * weight.ravel()) @ flat.T
        gradient = flat @ (weight * errors).ravel()
        inverse = 1.0 / self.spread[self.free] ** 2
        matrix += np.diag(inverse)
        return matrix, gradient + inverse * (x - self.center)[self.free]

    def slopes(self, x: Array, errors: Array, *, each: bool) -> Array:
        """Change of errors per unit of every free coordinate, (P, M, n)."""
        places = np.argwhere(self.free)
        probe = _PROBE * np.where(_logarithmic(), 1.0, self.spread)
        if each:
            groups = [place[None] for place in places]
        else:
            groups = [places[places[:, 0] == k] for k in np.unique(places[:, 0])]
        moved = []
        for group in groups:
            y = x.copy()
            y[group[:, 0], group[:, 1]] += probe[group[:, 0], group[:, 1]]
            moved.append(self.prior.moved(y))
        found: dict[tuple[int, int], Array] = {}
        for group, after in zip(groups, self.errors(moved), strict=True):
            for k, j in group.tolist():
                change = (after - errors) / probe[k, j]
                found[k, j] = change if each else _only(change, j)
        return np.array([found[k, j] for k, j in places.tolist()])


def fitted(
    simulator: ServoSimulator,
    stretches: Sequence[Stretch],
    *,
    start: Drive,
    prior: Drive,
    free: NDArray[np.bool_],
    progress: Callable[[str], None] = lambda _: None,
) -> DriveEstimate:
    """The most probable servos.

    Args:
        simulator: Replays.
        stretches: Logs.
        start: Where the search begins.
        prior: Numbers before a log is seen, from the robot file.
        free: Numbers that are fitted, (len(QUANTITIES), n); the others stay as in
            ``start``.
        progress: Is told what is done.
    """
    floor = np.maximum(resolution(stretches), 1e-4)
    problem = _Problem(simulator, stretches, prior, free, floor)
    x = start.coordinates
    drive = prior.moved(x)
    (errors,) = problem.errors([drive])
    for turn in range(_TURNS):
        problem.weigh(errors)
        before = problem.cost(errors, x)
        slopes = problem.slopes(x, errors, each=False)
        x, errors, after = _step(problem, x, errors, slopes, before)
        rms = 1000 * float(np.sqrt(np.mean(errors**2)))
        progress(f"servos: step {turn + 1} of at most {_TURNS}, {rms:.1f} mrad left")
        if before - after < _ENDS * abs(before):
            break
    problem.weigh(errors)
    progress("servos: how sure they are")
    matrix, _ = problem.normal(errors, problem.slopes(x, errors, each=True), x)
    covariance: Array = np.asarray(np.linalg.inv(matrix))
    # What these logs do not tell stays as it was known before.
    std = np.sqrt(np.diagonal(covariance))
    x[free] = np.where(
        std > _UNTOLD * problem.spread[free], problem.center[free], x[free]
    )
    cost = problem.cost(errors, x)
    return DriveEstimate(prior.moved(x), free, covariance, problem.sigma, cost)


def _step(
    problem: _Problem, x: Array, errors: Array, slopes: Array, before: float
) -> tuple[Array, Array, float]:
    """The best of several damped Gauss–Newton steps; none if all are worse."""
    matrix, gradient = problem.normal(errors, slopes, x)
    most = _LARGEST * np.where(_logarithmic(), 1.0, problem.spread)[problem.free]
    tried = []
    for damping in _DAMPINGS:
        damped = matrix + damping * np.diag(np.diagonal(matrix))
        y = x.copy()
        y[problem.free] += np.clip(-np.linalg.solve(damped, gradient), -most, most)
        tried.append(problem.prior.moved(y).coordinates)
    found = problem.errors([problem.prior.moved(y) for y in tried])
    costs = [problem.cost(e, y) for e, y in zip(found, tried, strict=True)]
    k = int(np.argmin(costs))
    return (tried[k], found[k], costs[k]) if costs[k] < before else (x, errors, before)


def _logarithmic() -> NDArray[np.bool_]:
    return np.array([q.positive for q in QUANTITIES])[:, None]


def _only(change: Array, j: int) -> Array:
    own = np.zeros_like(change)
    own[:, j] = change[:, j]
    return own


def _memory(x: Array) -> float:
    """Integrated autocorrelation of errors, in samples; Sokal's window."""
    size = len(x)
    spectrum = np.abs(np.fft.rfft(x, 2 * size)) ** 2
    products = np.fft.irfft(spectrum)[: min(_LONGEST, size)]
    if products[0] <= 0:
        return 1.0
    tau = 1.0 + 2.0 * np.cumsum(products[1:] / products[0])
    window = np.flatnonzero(np.arange(1, len(tau) + 1) > 5.0 * tau)
    return float(max(1.0, tau[window[0]] if len(window) else tau.max()))


def resolution(stretches: Sequence[Stretch]) -> Array:
    """Noise of positions from their steps: an encoder's, shape (n,), [rad]."""
    steps = np.concatenate([np.abs(np.diff(x.q, axis=0)) for x in stretches])
    told = np.where(steps > _SAME, steps, np.nan)
    moves = np.isfinite(told).any(axis=0)
    tick = np.full(steps.shape[1], np.nan)
    # Not the least: numbers that were rounded differ by less than a step.
    tick[moves] = np.nanquantile(told[:, moves], 0.1, axis=0)
    return np.asarray(np.nan_to_num(tick) / np.sqrt(12.0))
