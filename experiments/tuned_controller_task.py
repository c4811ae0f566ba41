"""Fast moves of an arm from rest to rest, under a controller of a few gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from hybrid import Motion, Robot
from hybrid.dynamics import inverse_dynamics
from hybrid.plant.servo import Servo

RATE, SUBSTEPS, MOVES = 500.0, 2, 4
MEMORY = 0.05  # s, of a disturbance
TURNS = 0.05  # rad/s: below, the sign of a speed is not full
RUNS, CHANGE = 6, 0.02  # of a tuning: looks at the simulator, and changes of a gain


class FileArms:
    """Arms of an MJCF file that MuJoCo steps, all at one time, as ``Lockstep`` does."""

    def __init__(self, file: Path, joints: Sequence[str], start: np.ndarray) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(file))
        self.at = [self.model.joint(x).qposadr[0] for x in joints]
        self.dof = [self.model.joint(x).dofadr[0] for x in joints]
        self.data = [mujoco.MjData(self.model) for _ in start]
        for data, q in zip(self.data, start, strict=True):
            data.qpos[self.at] = q
        self.q, self.v = start, np.zeros_like(start)

    def step(self, torque: np.ndarray, _: int) -> None:
        """Advance by one period of the controller."""
        count = round(1.0 / RATE / self.model.opt.timestep)
        for data, tau in zip(self.data, torque, strict=True):
            data.qfrc_applied[self.dof] = tau
            mujoco.mj_step(self.model, data, count)
        self.q = np.array([data.qpos[self.at] for data in self.data])
        self.v = np.array([data.qvel[self.dof] for data in self.data])


World = Callable[[np.ndarray], Any]  # arms at rest at (B, n) in a simulator


def moves(robot: Robot, rng: np.random.Generator) -> list[Motion]:
    """Moves of least jerk at 80 % of the arm's speed or acceleration, then rest."""
    ends = 0.35 * rng.uniform(robot.q_min, robot.q_max, (2, MOVES, robot.size))
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


def tuned(
    world: World, robot: Robot, servo: Servo, ways: Sequence[Motion]
) -> np.ndarray:
    """Gains with least squared tracking error in a simulator, shape (6, n).

    Gauss and Newton's, with slopes from differences; the same budget for each world.
    """
    ends = np.zeros((6, robot.size)), np.full((6, robot.size), 4.0)
    ends[0][:2], ends[1][:2] = 0.25, 1.0

    def off(x: np.ndarray) -> np.ndarray:
        gains = x.reshape(-1, 6, robot.size)
        feed = fed_forward(robot, ways, gains)
        own = tracked(world, servo, ways, feed, gains[:, :2])
        return own.reshape(len(own), -1)

    def slopes(x: np.ndarray) -> np.ndarray:
        step = np.where(x + CHANGE < ends[1].ravel(), CHANGE, -CHANGE)
        return (off(x + np.diag(step)) - off(x)).T / step

    start = np.tile([[0.5], [0.5], [1.0], [1.0], [0.1], [0.1]], robot.size)
    found = least_squares(
        lambda x: off(x)[0], start.ravel(), slopes, max_nfev=RUNS,
        bounds=tuple(x.ravel() for x in ends),
    )  # fmt: skip
    return np.asarray(found.x.reshape(6, -1))


def fed_forward(robot: Robot, ways: Sequence[Motion], gains: np.ndarray) -> np.ndarray:
    """Torque that K controllers feed forward, shape (K, M, N, n), [N·m].

    Args:
        robot: The nominal arm.
        ways: M moves.
        gains: Gains of each controller, shape (K, 6, n): the last four are multiples
            of the nominal weight and inertia, and of speed and its sign in tenths of
            rated torque.
    """
    chain, v = robot.chain, np.stack([m.v for m in ways])
    weight, rigid = (
        np.stack([inverse_dynamics(chain, chain.inertial, *x) for x in own])
        for own in (
            [(m.q, 0 * m.v, 0 * m.a) for m in ways],
            [(m.q, m.v, m.a) for m in ways],
        )
    )
    unit = 0.1 * robot.tau_max
    drag = unit / robot.v_max * v, unit * np.tanh(v / TURNS)
    parts = np.stack([weight, rigid - weight, *drag])
    return np.einsum("kpj,pmtj->kmtj", gains[:, 2:], parts)


def tracked(
    world: World,
    servo: Servo,
    ways: Sequence[Motion],
    feed: np.ndarray,
    gains: np.ndarray,
) -> np.ndarray:
    """Tracking errors of K controllers, shape (K, M, N, n), [rad].

    Args:
        world: Where they run.
        servo: Usual gains.
        ways: M moves.
        feed: Torque beside that of the gains, shape (K, M, N, n), [N·m].
        gains: Stiffness and damping as shares of those of a quarter of the usual
            bandwidth, shape (K, 2, n).
    """
    q, v = (np.stack([getattr(m, x) for m in ways]) for x in "qv")  # (M, N, n)
    kp, kd = gains[:, 0] * servo.kp / 16, gains[:, 1] * servo.kd / 4
    shape = len(gains), len(ways), q.shape[2]
    state = world(np.broadcast_to(q[:, 0], shape).reshape(-1, shape[2]).copy())
    off = np.empty(feed.shape)
    for k in range(q.shape[1]):
        off[:, :, k] = q[:, k] - state.q.reshape(shape)
        turn = v[:, k] - state.v.reshape(shape)
        pd = kp[:, None] * off[:, :, k] + kd[:, None] * turn
        state.step((feed[:, :, k] + pd).reshape(-1, shape[2]), SUBSTEPS)
    return off


def coloured(samples: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit size with a memory, shape (N, n)."""
    keep = np.exp(-1.0 / (RATE * MEMORY))
    white = np.sqrt(1 - keep**2) * rng.standard_normal((samples, n))
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))
