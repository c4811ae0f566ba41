"""Fast moves of an arm from rest to rest, under a torque and a soft controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from hybrid import Motion, Robot
from hybrid.plant import Plant
from hybrid.plant.lockstep import Lockstep

RATE, SUBSTEPS, MOVES = 1000.0, 4, 8
MEMORY = 0.05  # s, of a disturbance


def moves(robot: Robot, rng: np.random.Generator) -> list[Motion]:
    """Moves of least jerk at 80 % of the arm's speed or acceleration, then rest."""
    ends = 0.7 * rng.uniform(robot.q_min, robot.q_max, (2, MOVES, robot.size))
    far = np.abs(ends[1] - ends[0])
    times = np.maximum(
        (1.875 * far / (0.8 * robot.v_max)).max(axis=1),
        np.sqrt(5.774 * far / (0.8 * robot.a_max)).max(axis=1),
    )
    t, found = np.arange(round((times.max() + 0.3) * RATE)) / RATE, []
    for start, end, time in zip(*ends, times, strict=True):
        s = np.clip(t / time, 0.0, 1.0)[:, None]
        q = start + (end - start) * s**3 * (10 - 15 * s + 6 * s**2)
        v = (end - start) / time * 30 * s**2 * (1 - s) ** 2
        a = (end - start) / time**2 * 60 * s * (1 - s) * (1 - 2 * s)
        every = np.ones(len(t), dtype=bool)
        found.append(Motion(t, q, v, a, 0 * q, every, joints=robot.joints))
    return found


def tracked(
    plant: Plant, ways: Sequence[Motion], torque: np.ndarray, push: np.ndarray
) -> np.ndarray:
    """RMS tracking error of the plant for each of K torques, shape (K,), [mrad].

    Args:
        plant: The plant.
        ways: M moves.
        torque: Torque fed forward, shape (K, M, N, n), [N·m].
        push: Disturbance of each move, shape (M, N, n), [N·m].
    """
    kinds, count, samples, n = torque.shape
    q, v = (np.stack([getattr(m, x) for m in ways], axis=1) for x in "qv")
    q, v = (np.tile(x, (1, kinds, 1)) for x in (q, v))  # (N, K·M, n)
    feed = (torque + push).reshape(kinds * count, samples, n)
    state, servo = Lockstep(plant.arm, plant.effects, q[0]), plant.servo
    assert servo is not None
    squares = np.zeros(kinds * count)
    for k in range(samples):
        off = q[k] - state.q
        pd = servo.kp / 16 * off + servo.kd / 4 * (v[k] - state.v)
        squares += np.mean(off**2, axis=1)
        state.step(feed[:, k] + pd, SUBSTEPS)
    each = squares.reshape(kinds, count).mean(axis=1) / samples
    return np.asarray(1e3 * np.sqrt(each))


def coloured(samples: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit size with a memory, shape (N, n)."""
    keep = np.exp(-1.0 / (RATE * MEMORY))
    white = np.sqrt(1 - keep**2) * rng.standard_normal((samples, n))
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))
