"""The laws of a joint's servo, and its command, motion and torque."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from scipy.interpolate import CubicSpline

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import RigidBody
from hybrid.errors import HybridWarning
from hybrid.recording import Recording
from hybrid.recording.clock import resample
from hybrid.signals import Motion, motion_from_recording
from hybrid.signals.filters import butterworth

_POSITION_CUTOFF = 2.0  # cut-off of positions over that of the gap
_LATEST, MOST_SHIFT = 0.2, 0.05  # s; bounds of the effects latency and delay
LATENCIES = np.arange(0.0, _LATEST, 0.002)  # s
_ENOUGH = 2000  # samples, to scan latencies
FEWEST = 70  # samples of a joint: twenty periods of the cut-off
_CLIPPED = 0.98  # of the rated torque
# Signals of a joint, in the order of their columns.
(_FEED, _WEIGHT, _ERROR, _ASKED, _SPEED, _GROWTH, _ONE, _TORQUE, SLOPE) = range(9)
SIGNALS = 9


@dataclass(frozen=True, eq=False)
class Law:
    """A servo law of one joint, linear in its gains.

    τ(t + S) = c·F + k_p (q_ref(t − T) − q) + k_d (v_ref(t − T) − v) + h·a + constant.
    The feed-forward torque F is that of the simulator along the command, its gravity,
    or zero. The commanded speed v_ref may be absent. h is k_d times the delay of the
    speed that the servo measures, which is filtered or a difference of positions.
    """

    columns: Array  # the law's columns, of the signals of a joint, shape (9, p)
    target: Array  # the torque to be explained, of the same signals, shape (9,)
    # Whether the first column is the feed-forward torque (with the declared servo if
    # gains are given), for logs whose torque is off by a factor. Free gains come next.
    scaled: bool


def laws(kp: float = np.nan, kd: float = np.nan) -> Iterator[Law]:
    """Yield every servo law, with free or with given stiffness and damping."""
    unit = np.eye(SIGNALS)
    feeds = np.zeros(SIGNALS), unit[_FEED], unit[_WEIGHT]
    rest = [unit[_GROWTH], unit[_ONE]]
    for feed, speed in product(feeds, (unit[_ASKED] - unit[_SPEED], -unit[_SPEED])):
        for scaled in (False, True) if feed.any() else (False,):
            known, parts = feed, [unit[_ERROR], speed]
            if np.isfinite(kp):
                known, parts = feed + kp * parts[0] + kd * parts[1], []
            columns = np.stack([*([known] if scaled else []), *parts, *rest], axis=1)
            target = unit[_TORQUE] - (0.0 if scaled else known)
            yield Law(columns, target, scaled)


@dataclass(frozen=True, eq=False)
class ServoLog:
    """One joint's command, motion and torque, filtered as the gap is."""

    row: Index  # samples of the gap, shape (M,)
    t: Array  # their time, with a pause between recordings, shape (M,), [s]
    own: Array  # gravity torque, position, speed and acceleration, shape (M, 4)
    asked: CubicSpline  # feed-forward torque, commanded position and speed, over time
    torque: CubicSpline  # logged torque, over time

    def signals(self, late: float, shift: float) -> Array:
        """All signals at command latency T and torque delay S, [s], shape (M, 9)."""
        A = np.empty((SIGNALS, len(self.t)))  # time is contiguous
        A[_WEIGHT], q, A[_SPEED], A[_GROWTH] = self.own.T
        A[_FEED], A[_ERROR], A[_ASKED] = self.asked(self.t - late).T
        A[_ERROR] -= q
        A[_ONE] = 1.0
        A[_TORQUE], A[SLOPE] = self._logged(shift) if shift else self._unshifted
        return A.T

    def drift(self, late: float) -> Array:
        """Derivative of all signals with respect to T, shape (M, 9)."""
        A = np.zeros((SIGNALS, len(self.t)))
        A[_FEED], A[_ERROR], A[_ASKED] = -self.asked(self.t - late, 1).T
        return A.T

    def _logged(self, shift: float) -> Array:
        """Logged torque, shifted by S, and its derivative, shape (2, M)."""
        at = self.t + shift
        return np.stack([self.torque(at), self.torque(at, 1)])

    @cached_property
    def _unshifted(self) -> Array:
        return self._logged(0.0)

    @cached_property
    def products(self) -> Array:
        """Cross-products of all signals at every latency of the scan, (K, 9, 9)."""
        signals = (self.thin.signals(late, 0.0) for late in LATENCIES)
        return np.stack([A.T @ A for A in signals])

    @cached_property
    def thin(self) -> Self:
        """A subset of the samples, to find an initial guess."""
        return self.at(slice(None, None, max(1, len(self.row) // _ENOUGH)))

    def at(self, use: Mask | slice) -> Self:
        """Some of the samples."""
        return replace(self, row=self.row[use], t=self.t[use], own=self.own[use])


def servo_logs(
    gap: Gap, recordings: Sequence[Recording | Motion]
) -> list[ServoLog | None]:
    """Servo signals of each joint that was commanded and moves; ``None`` for others."""
    clock, parts, rows = 0.0, [], []
    for k, recording in enumerate(recordings):
        if isinstance(recording, Recording) and recording.command is not None:
            part = _signals(gap, k, recording)
            here = np.flatnonzero(gap.trajectory == k)
            since = gap.sampled.t[here] - gap.motions[k].t[0]
            rows.append((here, clock - part[0][0] + since, since > _LATEST))
            parts.append((clock - part[0][0] + part[0], *part[1:]))
            clock = parts[-1][0][-1] + gap.period
    if not parts:
        return [None] * gap.robot.size
    t, asked, torque, own = map(np.concatenate, zip(*parts, strict=True))
    row, at, known = map(np.concatenate, zip(*rows, strict=True))
    found: list[ServoLog | None] = []
    for i in range(gap.robot.size):
        whole = CubicSpline(t, torque[:, i])
        clipped = np.abs(whole(at)) > _CLIPPED * gap.robot.tau_max[i]
        use = known & gap.moving[row, i] & ~clipped
        log = ServoLog(row, at, own[:, :, i], CubicSpline(t, asked[:, :, i]), whole)
        found.append(log.at(use) if np.count_nonzero(use) >= FEWEST else None)
    return found


def _signals(
    gap: Gap, k: int, recording: Recording
) -> tuple[Array, Array, Array, Array]:
    """Padded time, command (N + 2P, 3, n) and torque; own signals (M, 4, n)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # given with the gap already
        recording = resample(recording.in_order(gap.robot.joints))
    assert recording.command is not None
    motion, chain = gap.motions[k], gap.robot.chain
    wanted = motion_from_recording(
        replace(recording, q=recording.command, v=None),
        cutoff=_POSITION_CUTOFF * gap.cutoff,
    )
    feed = RigidBody(chain, wanted).load + chain.armature * wanted.a
    still = replace(motion, v=0 * motion.v, a=0 * motion.a)
    weight = RigidBody(chain, still).load
    asked = np.stack([feed, wanted.q, wanted.v], axis=1)
    rate = wanted.rate
    held = int(np.ceil((_LATEST + MOST_SHIFT) * rate)) + 1
    t = np.arange(-held, len(wanted.t) + held) / rate

    def padded(x: Array) -> Array:
        x = butterworth(x, rate=rate, cutoff=gap.cutoff)
        return np.pad(x, ((held, held), *[(0, 0)] * (x.ndim - 1)), mode="edge")

    own = gap.samplers[k](np.stack([weight, motion.q, motion.v, motion.a], axis=1))
    return t, padded(asked), padded(recording.tau), own
