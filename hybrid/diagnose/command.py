"""The link from command to torque: what a servo is asked for, and what it gives."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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
_STEP = 0.004  # s
_ROUNDS, _CONVERGED = 12, 1e-6  # s
_FEWEST = 100  # samples of a joint
_CLIPPED = 0.98  # of the rated torque
# Signals of a joint, in the order of their columns.
_FEED, _WEIGHT, _ERROR, _ASKED, _SPEED, _ONE, _TORQUE, _SLOPE = range(8)


@dataclass(frozen=True, eq=False)
class Law:
    """A servo law of one joint, linear in its gains.

    τ(t + S) = c·F + k_p (q_ref(t − T) − q) + k_d (v_ref(t − T) − v) + constant, with F
    the torque fed forward: of the simulator along the command, its gravity, or none;
    and with or without the commanded speed.

    Attributes:
        columns: Its columns in terms of a joint's signals, shape (8, p).
        target: Torque to explain in terms of them, shape (8,).
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
    unit = np.eye(8)
    for feed in (unit[_FEED], unit[_WEIGHT], None):
        for speed in (unit[_ASKED] - unit[_SPEED], -unit[_SPEED]):
            target, first = unit[_TORQUE], [] if feed is None else [feed]
            parts = [*first, unit[_ERROR], speed, unit[_ONE]]
            if np.isfinite(kp):
                servo = kp * unit[_ERROR] + kd * speed
                parts = [unit[_ONE]] if feed is None else [feed + servo, unit[_ONE]]
                target = target - servo if feed is None else target
            k = len(first)
            yield Law(np.stack(parts, axis=1), target, (0 if k else None, k, k + 1))


@dataclass(frozen=True, eq=False)
class Servo:
    """One joint's command, motion and torque, filtered as the gap is.

    Attributes:
        row: Samples of the gap, shape (M,).
        t: Their time; each recording is apart from the next, shape (M,), [s].
        own: Gravity, position and speed there, shape (M, 3).
        asked: Torque fed forward, position and speed commanded at any time.
        torque: Torque logged at any time.
    """

    row: Index
    t: Array
    own: Array
    asked: CubicSpline
    torque: CubicSpline

    def signals(self, late: float, shift: float, slope: bool = False) -> Array:
        """All signals with commands late by T and torque by S, shape (M, 8).

        Args:
            late: T, [s].
            shift: S, [s].
            slope: Their change with T in its stead.
        """
        A = np.zeros((len(self.t), 8))
        weight, q, v = self.own.T
        if slope:
            A[:, [_FEED, _ERROR, _ASKED]] = -self.asked(self.t - late, 1)
            return A
        A[:, [_FEED, _ERROR, _ASKED]] = self.asked(self.t - late)
        A[:, _ERROR] -= q
        A[:, _WEIGHT], A[:, _SPEED], A[:, _ONE] = weight, v, 1.0
        A[:, _TORQUE] = self.torque(self.t + shift)
        A[:, _SLOPE] = self.torque(self.t + shift, 1)
        return A

    def only(self, use: NDArray[np.bool_]) -> Servo:
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

    def residual(self, servo: Servo) -> Array:
        """Torque that the law leaves on other samples, shape (M,), [N·m]."""
        A = servo.signals(self.late, self.shift)
        return np.asarray(A @ (self.law.target - self.law.columns @ self.gains))


def fit(servo: Servo, choice: Sequence[Law], *, prompt: bool) -> Fit:
    """The law, the shifts and the gains that leave least.

    The scan takes all laws at all latencies from one set of cross-products; the best is
    refined by Gauss–Newton steps.

    Args:
        servo: Signals of a joint.
        choice: Laws to choose from.
        prompt: Whether torque must follow the command at once: a position that is
            logged late, or torque, is no latency.
    """
    best: list[tuple[float, int, tuple[float, float], Array]] = []
    for late in np.arange(0.0, _LATEST, _STEP):
        A = servo.signals(late, 0.0)
        G = A.T @ A
        for k, law in enumerate(choice):
            best += [(x, k, z, B) for x, z, B in _scan(G, law, late, prompt)]
    _, k, start, basis = min(best, key=lambda x: x[0])
    return _refined(servo, choice[k], np.array(start), basis)


def _scan(
    G: Array, law: Law, late: float, prompt: bool
) -> Iterator[tuple[float, tuple[float, float], Array]]:
    """Squares left, shifts, and in which directions these may change."""
    unit = np.eye(8)[_SLOPE]
    free = np.column_stack([law.columns, -unit])
    if not prompt or late == 0.0:
        squares, x = _solve(G, free, law.target)
        shift = float(np.clip(x[-1], -_MOST_SHIFT, _MOST_SHIFT))
        if not prompt:
            yield squares, (late, shift), np.eye(2)
        elif shift >= 0:
            yield squares, (0.0, shift), np.array([[0.0], [1.0]])
        else:
            yield _solve(G, law.columns, law.target)[0], (0.0, 0.0), np.zeros((2, 0))
    if prompt and 0 < late <= _MOST_SHIFT:
        squares, _ = _solve(G, law.columns, law.target - late * unit)
        yield squares, (late, -late), np.array([[1.0], [-1.0]])


def _solve(G: Array, columns: Array, target: Array) -> tuple[float, Array]:
    H, s = columns.T @ G @ columns, columns.T @ G @ target
    d = 1 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    x = d * np.linalg.lstsq(H * d * d[:, None], s * d, rcond=1e-12)[0]
    return float(target @ G @ target - s @ x), x


def _refined(servo: Servo, law: Law, x: Array, basis: Array) -> Fit:
    """Gauss–Newton steps from shifts x = (T, S) along the directions of a basis."""
    at_once = basis.shape[1] < 2
    for _ in range(_ROUNDS):
        A = servo.signals(*x)
        X, y = A @ law.columns, A @ law.target
        gains = _least(X, y)
        mix = law.target - law.columns @ gains
        turn = np.column_stack([servo.signals(*x, slope=True) @ mix, A[:, _SLOPE]])
        J = np.column_stack([turn @ basis, -X])
        left = y - X @ gains
        step = basis @ -_least(J, left)[: basis.shape[1]]
        if np.abs(step).max() < _CONVERGED:
            break
        x = x + np.clip(step, -_STEP, _STEP)
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


def servos(gap: Gap, recordings: Sequence[Recording | Motion]) -> list[Servo | None]:
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
    found: list[Servo | None] = []
    for i in range(gap.robot.size):
        whole = CubicSpline(t, torque[:, i])
        clipped = np.abs(whole(at)) > _CLIPPED * gap.robot.tau_max[i]
        use = known & gap.moving[row, i] & ~clipped
        if np.count_nonzero(use) < _FEWEST:
            found.append(None)
            continue
        found.append(
            Servo(row[use], at[use], own[use, :, i],
                  CubicSpline(t, asked[:, :, i]), whole)
        )  # fmt: skip
    return found


def _signals(
    gap: Gap, k: int, recording: Recording
) -> tuple[Array, Array, Array, Array]:
    """One recording: a longer clock, (N + 2P, 3, n) asked, torque, (M, 3, n) own."""
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

    own = gap.samplers[k](np.stack([weight, motion.q, motion.v], axis=1))
    return t, longer(asked), longer(recording.tau), own
