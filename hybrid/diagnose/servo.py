"""A servo law of one joint, found from what it was asked for and what it gave."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hybrid.diagnose.bayes import memory
from hybrid.diagnose.gap import Gap
from hybrid.dynamics import RigidBody
from hybrid.errors import HybridWarning
from hybrid.recording import Recording
from hybrid.recording.clock import resample
from hybrid.robot.chain import Array
from hybrid.signals import Motion, motion_from_recording
from hybrid.signals.filters import butterworth

Index = NDArray[np.intp]

_POSITION_CUTOFF = 2.0  # of the gap's, as positions are filtered
_LATEST, _MOST_SHIFT = 0.2, 0.05  # s; as the effects latency and delay allow
_STEP = 0.001  # s
_GRID = np.arange(0.0, _LATEST, _STEP)
_RIDGE = 1e-10
_ROUNDS, _LONGEST, _CONVERGED = 12, 0.004, 1e-6  # s
_ENOUGH = 2000  # samples, to scan
WORTH = 14.0  # nat, with the price of a shape
FEWEST = 100  # samples of a joint
_CLIPPED = 0.98  # of the rated torque
# Signals of a joint, in the order of their columns.
(_FEED, _WEIGHT, _ERROR, _ASKED, _SPEED, _GROWTH, _ONE, _TORQUE, _SLOPE) = range(9)
_SIGNALS = 9


@dataclass(frozen=True, eq=False)
class Law:
    """A servo law of one joint, linear in its gains.

    τ(t + S) = c·F + k_p (q_ref(t − T) − q) + k_d (v_ref(t − T) − v) + h·a + constant,
    with F the torque fed forward: of the simulator along the command, its gravity, or
    none; and with or without the commanded speed. h = k_d times the age of the speed
    that the servo sees: it is filtered, or from differences.

    Attributes:
        columns: Its columns in terms of a joint's signals, shape (9, p).
        target: Torque to explain in terms of them, shape (9,).
        gains: Places of torque fed forward, stiffness and damping in the columns.
    """

    columns: Array
    target: Array
    gains: tuple[int | None, int, int]


def laws(kp: float = np.nan, kd: float = np.nan) -> Iterator[Law]:
    """Every law, with free gains or with stated ones.

    Stated gains leave the scale of the torque free where it can be told, with torque
    fed forward: a log may be off by a factor.

    Args:
        kp: Stiffness, [N·m/rad]; free if not given.
        kd: Damping, [N·m·s/rad].
    """
    unit = np.eye(_SIGNALS)
    for feed in (unit[_FEED], unit[_WEIGHT], None):
        for speed in (unit[_ASKED] - unit[_SPEED], -unit[_SPEED]):
            target, first = unit[_TORQUE], [] if feed is None else [feed]
            rest = [unit[_GROWTH], unit[_ONE]]
            parts = [*first, unit[_ERROR], speed, *rest]
            if np.isfinite(kp):
                servo = kp * unit[_ERROR] + kd * speed
                parts = rest if feed is None else [feed + servo, *rest]
                target = target - servo if feed is None else target
            k = len(first)
            yield Law(np.stack(parts, axis=1), target, (0 if k else None, k, k + 1))


@dataclass(frozen=True, eq=False)
class ServoLog:
    """One joint's command, motion and torque, filtered as the gap is.

    Attributes:
        row: Samples of the gap, shape (M,).
        t: Their time; each recording is apart from the next, shape (M,), [s].
        own: Gravity, position, speed and acceleration there, shape (M, 4).
        asked: Torque fed forward, position and speed commanded at any time.
        torque: Torque logged at any time.
    """

    row: Index
    t: Array
    own: Array
    asked: CubicSpline
    torque: CubicSpline

    def signals(self, late: float, shift: float, slope: bool = False) -> Array:
        """All signals with commands late by T and torque by S, shape (M, 9).

        Args:
            late: T, [s].
            shift: S, [s].
            slope: Their change with T in its stead.
        """
        A = np.zeros((len(self.t), _SIGNALS))
        weight, q, v, a = self.own.T
        if slope:
            A[:, [_FEED, _ERROR, _ASKED]] = -self.asked(self.t - late, 1)
            return A
        A[:, [_FEED, _ERROR, _ASKED]] = self.asked(self.t - late)
        A[:, _ERROR] -= q
        A[:, _WEIGHT], A[:, _SPEED], A[:, _GROWTH], A[:, _ONE] = weight, v, a, 1.0
        A[:, _TORQUE] = self.torque(self.t + shift)
        A[:, _SLOPE] = self.torque(self.t + shift, 1)
        return A

    @cached_property
    def products(self) -> Array:
        """Cross-products of all signals at every latency of the scan, (K, 9, 9)."""
        signals = (self.thin.signals(late, 0.0) for late in _GRID)
        return np.stack([A.T @ A for A in signals])

    @cached_property
    def thin(self) -> ServoLog:
        """Some of the samples, enough to look for a start."""
        k = max(1, len(self.row) // _ENOUGH)
        return replace(self, row=self.row[::k], t=self.t[::k], own=self.own[::k])

    def only(self, use: NDArray[np.bool_]) -> ServoLog:
        """The samples of a mask over the gap's, shape (all,)."""
        k = use[self.row]
        return replace(self, row=self.row[k], t=self.t[k], own=self.own[k])


@dataclass(frozen=True, eq=False)
class Fit:
    """A servo law with its shifts and gains.

    Attributes:
        law: The law.
        late: Commands act late by T after the position, [s].
        shift: Torque is logged late by S after the position, [s].
        gains: Gain of each column, shape (p,).
        left: Torque left, shape (M,), [N·m].
        covariance: Of T, S and the gains, shape (2 + p, 2 + p).
    """

    law: Law
    late: float
    shift: float
    gains: Array
    left: Array
    covariance: Array

    @property
    def latency(self) -> float:
        """From command to torque, whichever of both the position is in step with."""
        return self.late + min(self.shift, 0.0)

    @property
    def latency_std(self) -> float:
        """Standard deviation of the latency, [s]."""
        way = np.array([1.0, float(self.shift < 0)])
        return float(np.sqrt(way @ self.covariance[:2, :2] @ way))

    def residual(self, servo: ServoLog) -> Array:
        """Torque that the law leaves on other samples, shape (M,), [N·m]."""
        A = servo.signals(self.late, self.shift)
        return np.asarray(A @ (self.law.target - self.law.columns @ self.gains))


def fit(servo: ServoLog, choice: Sequence[Law], *, prompt: bool) -> Fit:
    """The law, the shifts and the gains that leave least.

    A scan takes all laws at all latencies from one set of cross-products; the best of
    each law is refined by Gauss–Newton steps. Torque is in step with the position
    unless there is evidence that it is not.

    Args:
        servo: Signals of a joint.
        choice: Laws to choose from.
        prompt: Whether torque must follow the command at once: a position that is
            logged late, or torque, is no latency.
    """

    def best(shifted: bool) -> Fit:
        fits = []
        for law in choice:
            start, basis = _start(servo.products, law, prompt, shifted)
            fits.append((_refined(servo.thin, law, start, basis), basis))
        found, basis = min(fits, key=lambda x: float(x[0].left @ x[0].left))
        return _refined(servo, found.law, np.array([found.late, found.shift]), basis)

    plain, shifted = best(False), best(True)
    return shifted if evidence(servo, plain, shifted) > WORTH else plain


def at_once(servo: ServoLog, choice: Sequence[Law], found: Fit) -> Fit:
    """The law and the gains that leave least without any latency.

    Args:
        servo: Signals of a joint.
        choice: Laws to choose from.
        found: A fit whose shift of the torque stays.
    """
    still = np.array([max(0.0, -found.shift), found.shift])
    fits = [_refined(servo, law, still, np.zeros((2, 0))) for law in choice]
    return min(fits, key=lambda x: float(x.left @ x.left))


def evidence(servo: ServoLog, without: Fit, with_: Fit) -> float:
    """Logarithm of the likelihood that a fit has more than another, [nat]."""
    independent = len(servo.row) / memory(with_.left, servo.row)
    before, after = without.left @ without.left, with_.left @ with_.left
    return float(independent / 2 * np.log(before / after))


def _start(G: Array, law: Law, prompt: bool, shifted: bool) -> tuple[Array, Array]:
    """Shifts (T, S) of the scan, and the directions in which these may change."""
    slope, along = np.eye(_SIGNALS)[_SLOPE], np.eye(2)
    if not shifted:
        late = _GRID[np.argmin(_solve(G, law.columns, law.target)[0])]
        if prompt:
            return np.zeros(2), np.zeros((2, 0))
        return np.array([late, 0.0]), along[:, :1]
    squares, x = _solve(G, np.column_stack([law.columns, -slope]), law.target)
    shift = np.clip(x[:, -1], -_MOST_SHIFT, _MOST_SHIFT)
    if not prompt:
        k = int(np.argmin(squares))
        return np.array([_GRID[k], shift[k]]), along
    # Either the torque is logged late, or the position, and all follows the command.
    behind = law.target - _GRID[_GRID <= _MOST_SHIFT, None] * slope
    others, _ = _solve(G[: len(behind)], law.columns, behind)
    k = int(np.argmin(others))
    if shift[0] > 0 and squares[0] < others[k]:
        return np.array([0.0, shift[0]]), along[:, 1:]
    return np.array([_GRID[k], -_GRID[k]]), np.array([[1.0], [-1.0]])


def _solve(G: Array, columns: Array, target: Array) -> tuple[Array, Array]:
    """Squares left (K,) and gains (K, p) of cross-products, shape (K, 9, 9)."""
    H = columns.T @ G @ columns
    target = np.broadcast_to(target, G.shape[:2])
    pull = np.einsum("kij,kj->ki", G, target)
    s = pull @ columns
    d = 1 / np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), 1e-300))
    H = H * d[:, :, None] * d[:, None, :] + _RIDGE * np.eye(H.shape[1])
    x = d * np.linalg.solve(H, (s * d)[:, :, None])[:, :, 0]
    return np.einsum("ki,ki->k", pull, target) - np.einsum("ki,ki->k", s, x), x


def _refined(servo: ServoLog, law: Law, x: Array, basis: Array) -> Fit:
    """Gauss–Newton steps from shifts x = (T, S) along the directions of a basis."""
    at_once = basis.shape[1] == 1 and basis[1, 0] != 0
    for _ in range(_ROUNDS):
        A = servo.signals(*x)
        X, y = A @ law.columns, A @ law.target
        gains = _least(X, y)
        mix = law.target - law.columns @ gains
        turn = np.column_stack([servo.signals(*x, slope=True) @ mix, A[:, _SLOPE]])
        J = np.column_stack([turn @ basis, -X])
        left = y - X @ gains
        step = basis @ -_least(J, left)[: basis.shape[1]]
        if np.all(np.abs(step) < _CONVERGED):
            break
        x = x + np.clip(step, -_LONGEST, _LONGEST)
        if at_once and (x[0] < 0 or x.sum() < 0):
            x = np.zeros(2)
    d = 1 / np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    spread = np.linalg.pinv((J * d).T @ (J * d), rcond=1e-12) * d * d[:, None]
    spread *= left @ left / len(left) * memory(left, servo.row)
    wide = np.eye(2 + len(gains))[:, 2:]
    wide = np.column_stack([np.pad(basis, ((0, len(gains)), (0, 0))), wide])
    return Fit(law, float(x[0]), float(x[1]), gains, left, wide @ spread @ wide.T)


def _least(X: Array, y: Array) -> Array:
    d = 1 / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    return np.asarray(d * np.linalg.lstsq(X * d, y, rcond=1e-10)[0])


def servo_logs(
    gap: Gap, recordings: Sequence[Recording | Motion]
) -> list[ServoLog | None]:
    """Signals of each joint, of the recordings that have a command.

    Args:
        gap: The gap.
        recordings: What it was measured from.

    Returns:
        Nothing for joints that hardly move, or where no command was logged.
    """
    clock, parts, rows = 0.0, [], []
    for k, recording in enumerate(recordings):
        if isinstance(recording, Recording) and recording.command is not None:
            part = _signals(gap, k, recording)
            own = np.flatnonzero(gap.trajectory == k)
            since = gap.sampled.t[own] - gap.motions[k].t[0]
            rows.append((own, clock - part[0][0] + since, since > _LATEST))
            parts.append((clock - part[0][0] + part[0], *part[1:]))
            clock = parts[-1][0][-1] + 1 / gap.motions[k].rate
    if not parts:
        return [None] * gap.robot.size
    t, asked, torque, own = map(np.concatenate, zip(*parts, strict=True))
    row, at, known = map(np.concatenate, zip(*rows, strict=True))
    found: list[ServoLog | None] = []
    for i in range(gap.robot.size):
        whole = CubicSpline(t, torque[:, i])
        clipped = np.abs(whole(at)) > _CLIPPED * gap.robot.tau_max[i]
        use = known & gap.moving[row, i] & ~clipped
        if np.count_nonzero(use) < FEWEST:
            found.append(None)
            continue
        found.append(
            ServoLog(row[use], at[use], own[use, :, i],
                  CubicSpline(t, asked[:, :, i]), whole)
        )  # fmt: skip
    return found


def _signals(
    gap: Gap, k: int, recording: Recording
) -> tuple[Array, Array, Array, Array]:
    """One recording: a longer clock, (N + 2P, 3, n) asked, torque, (M, 4, n) own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # said when the gap was measured
        recording = resample(recording.in_order(gap.robot.joints))
    assert recording.command is not None
    motion, chain = gap.motions[k], gap.robot.chain
    wanted = motion_from_recording(
        replace(recording, q=recording.command), cutoff=_POSITION_CUTOFF * gap.cutoff
    )
    feed = RigidBody(chain, wanted).load + chain.armature * wanted.a
    still = replace(motion, v=0 * motion.v, a=0 * motion.a)
    weight = RigidBody(chain, still).load
    asked = np.stack([feed, wanted.q, wanted.v], axis=1)
    held = int(np.ceil((_LATEST + _MOST_SHIFT) * motion.rate)) + 1
    t = np.arange(-held, len(motion.t) + held) / motion.rate

    def longer(x: Array) -> Array:
        x = butterworth(x, rate=motion.rate, cutoff=gap.cutoff)
        return np.pad(x, ((held, held), *[(0, 0)] * (x.ndim - 1)), mode="edge")

    own = gap.samplers[k](np.stack([weight, motion.q, motion.v, motion.a], axis=1))
    return t, longer(asked), longer(recording.tau), own
