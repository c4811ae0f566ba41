"""Fit of a servo law: its gains, its latency, and the delay of the logged torque."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.noise import noise_bound
from hybrid.diagnosis.gap.servo import (
    LATENCIES,
    MOST_SHIFT,
    SIGNALS,
    SLOPE,
    Law,
    ServoLog,
)
from hybrid.signals import autocorrelation_time

WORTH = 14.0  # nat, odds against one more parameter of a servo
_ROUNDS, _LONGEST, _CONVERGED = 12, 0.004, 1e-6  # iterations; steps, [s]
_RIDGE = 1e-10
_MOST_SCALE = 0.3  # relative error of a log's torque scale
_MUCH = 0.5  # of the squares without a delay, those that a delay leaves at most


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted servo law.

    Attributes:
        law: The law.
        late: Latency T from command to logged position, [s].
        shift: Delay S of the logged torque behind the logged position, [s].
        gains: Gain of each column, shape (p,).
        left: Residual torque, shape (M,), [N·m].
        covariance: Covariance of T, S and the gains, shape (2 + p, 2 + p).
    """

    law: Law
    late: float
    shift: float
    gains: Array
    left: Array
    covariance: Array

    @property
    def latency(self) -> float:
        """Latency from command to torque, [s], whichever of both was logged late."""
        return self.late + min(self.shift, 0.0)

    @property
    def latency_std(self) -> float:
        """Standard deviation of the latency, [s]."""
        way = np.array([1.0, float(self.shift < 0)])
        return float(np.sqrt(way @ self.covariance[:2, :2] @ way))

    def residual(self, servo: ServoLog) -> Array:
        """Residual torque on other samples, shape (M,), [N·m]."""
        A = servo.signals(self.late, self.shift)
        return np.asarray(A @ (self.law.target - self.law.columns @ self.gains))


def fit(servo: ServoLog, choice: Sequence[Law], *, immediate: bool) -> Fit:
    """Fit the law, latency, delay and gains with the least squared residual.

    All laws are scanned over all latencies, from one set of cross-products. The best
    law and latency are refined by Gauss–Newton steps. A scale of the torque, and a
    delay of it, are fitted only where there is evidence for them.

    With ``immediate`` torque must follow the command without latency; the logged
    torque, or the logged position, may still be late.
    """

    def best(scaled: bool, shifted: bool) -> Fit | None:
        starts = [
            (*_start(servo.products, law, immediate, shifted), law)
            for law in choice
            if law.scaled == scaled
        ]
        if not starts:
            return None
        # The scan over latencies knows a delay of the torque only to first order.
        few = sorted(starts, key=lambda x: x[0])[: 1 + shifted]
        tried = [
            (_stepped(servo.thin, law, x, way), law, way) for _, x, way, law in few
        ]
        (x, *_), law, along = min(tried, key=lambda k: float(k[0][2] @ k[0][2]))
        return _refined(servo, law, x, along)

    at_scale, scaled = best(False, False), best(True, False)
    if at_scale and scaled and abs(scaled.gains[0] - 1.0) > _MOST_SCALE:
        scaled = None  # such a law does not fit
    found = _more_likely(servo, at_scale, scaled)
    shifted = best(found.law.scaled, True)
    # A small improvement may come from noise of the position.
    if shifted and shifted.left @ shifted.left > _MUCH * (found.left @ found.left):
        shifted = None
    return _more_likely(servo, found, shifted)


def _more_likely(servo: ServoLog, found: Fit | None, other: Fit | None) -> Fit:
    """The first fit, or the second and less simple one if there is evidence for it."""
    if found is None or other is None:
        only = found or other
        assert only is not None
        return only
    return other if log_likelihood_ratio(servo, found, other) > WORTH else found


def fit_without_latency(servo: ServoLog, choice: Sequence[Law], found: Fit) -> Fit:
    """Fit the law and the gains without latency, at the torque delay of another fit."""
    still = np.array([max(0.0, -found.shift), found.shift])
    fits = [
        _refined(servo, law, still, np.zeros((2, 0)))
        for law in choice
        if law.scaled == found.law.scaled
    ]
    return min(fits, key=lambda x: float(x.left @ x.left))


def hidden_damping(servo: ServoLog, found: Fit, rate: float, cutoff: float) -> float:
    """Largest part of the damping that noise of the speed may hide, 0 to 1.

    The estimated gain of a noisy regressor is too small: by the noise variance over the
    variance that the other regressors do not explain (errors in variables). ``rate``
    and ``cutoff`` of the signals are in [Hz].
    """
    A, law = servo.signals(found.late, found.shift), found.law
    X, at = A @ law.columns, 2 if law.scaled else 1
    speed, others = X[:, at], [np.delete(X, at, axis=1)]
    if found.shift:
        others.append(A[:, [SLOPE]])
    if found.late:
        change = servo.drift(found.late) @ (law.target - law.columns @ found.gains)
        others.append(change[:, None])
    rest = np.column_stack(others)
    own = speed - rest @ _least(rest, speed)
    noise = noise_bound(speed, servo.row, rate, cutoff)
    return min(1.0, noise / max(float(own @ own) / len(own), 1e-300))


def log_likelihood_ratio(servo: ServoLog, first: Fit, second: Fit) -> float:
    """Log likelihood of the second fit less that of the first, [nat]."""
    independent = len(servo.row) / autocorrelation_time(second.left, servo.row)
    before, after = first.left @ first.left, second.left @ second.left
    return float(independent / 2 * np.log(before / after))


def _start(
    G: Array, law: Law, immediate: bool, shifted: bool
) -> tuple[float, Array, Array]:
    """Squares and (T, S) of the scan's best, and the directions of a refinement."""
    slope, along = np.eye(SIGNALS)[SLOPE], np.eye(2)
    if not shifted:
        squares = _solve(G, law.columns, law.target)[0]
        if immediate:
            return squares[0], np.zeros(2), np.zeros((2, 0))
        k = int(np.argmin(squares))
        return squares[k], np.array([LATENCIES[k], 0.0]), along[:, :1]
    squares, x = _solve(G, np.column_stack([law.columns, -slope]), law.target)
    shift = np.clip(x[:, -1], -MOST_SHIFT, MOST_SHIFT)
    if not immediate:
        k = int(np.argmin(squares))
        return squares[k], np.array([LATENCIES[k], shift[k]]), along
    # Either the torque or the position was logged late.
    behind = law.target - LATENCIES[LATENCIES <= MOST_SHIFT, None] * slope
    others, _ = _solve(G[: len(behind)], law.columns, behind)
    k = int(np.argmin(others))
    if shift[0] > 0 and squares[0] < others[k]:
        return squares[0], np.array([0.0, shift[0]]), along[:, 1:]
    start = np.array([LATENCIES[k], -LATENCIES[k]])
    return others[k], start, np.array([[1.0], [-1.0]])


def _solve(G: Array, columns: Array, target: Array) -> tuple[Array, Array]:
    """Residual squares (K,) and gains (K, p) from cross-products (K, 9, 9)."""
    H = columns.T @ G @ columns
    target = np.broadcast_to(target, G.shape[:2])
    pull = np.einsum("kij,kj->ki", G, target)
    s = pull @ columns
    d = 1 / np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), 1e-300))
    H = H * d[:, :, None] * d[:, None, :] + _RIDGE * np.eye(H.shape[1])
    x = d * np.linalg.solve(H, (s * d)[:, :, None])[:, :, 0]
    return np.einsum("ki,ki->k", pull, target) - np.einsum("ki,ki->k", s, x), x


def _refined(servo: ServoLog, law: Law, x: Array, basis: Array) -> Fit:
    """Refine x = (T, S) along the directions of a basis by Gauss–Newton steps."""
    x, gains, left, J = _stepped(servo, law, x, basis)
    d = _inverse(np.linalg.norm(J, axis=0))
    spread = np.linalg.pinv((J * d).T @ (J * d), rcond=1e-12) * d * d[:, None]
    spread *= left @ left / len(left) * autocorrelation_time(left, servo.row)
    wide = np.eye(2 + len(gains))[:, 2:]
    wide = np.column_stack([np.pad(basis, ((0, len(gains)), (0, 0))), wide])
    return Fit(law, float(x[0]), float(x[1]), gains, left, wide @ spread @ wide.T)


def _stepped(
    servo: ServoLog, law: Law, x: Array, basis: Array
) -> tuple[Array, Array, Array, Array]:
    """(T, S) after the steps of :func:`_refined`; gains, residual and its Jacobian."""
    immediate = basis.shape[1] == 1 and basis[1, 0] != 0
    for _ in range(_ROUNDS):
        A = servo.signals(*x)
        X, y = A @ law.columns, A @ law.target
        gains = _least(X, y)
        mix = law.target - law.columns @ gains
        turn = np.column_stack([servo.drift(x[0]) @ mix, A[:, SLOPE]])
        J = np.column_stack([turn @ basis, -X])
        left = y - X @ gains
        step = basis @ -_least(J, left)[: basis.shape[1]]
        if np.all(np.abs(step) < _CONVERGED):
            break
        x = x + np.clip(step, -_LONGEST, _LONGEST)
        if immediate and (x[0] < 0 or x.sum() < 0):
            x = np.zeros(2)
    return x, gains, left, J


def _least(X: Array, y: Array) -> Array:
    """Least-squares gains, with columns scaled to unit length."""
    d = _inverse(np.linalg.norm(X, axis=0))
    return np.asarray(d * np.linalg.lstsq(X * d, y, rcond=1e-10)[0])


def _inverse(size: Array) -> Array:
    """1/size, and zero for a signal that is zero throughout."""
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 1e-200)
