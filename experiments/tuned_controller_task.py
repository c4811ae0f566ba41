"""Short slow strokes of an arm, there and back, under a controller of a few gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from hybrid import Motion, Robot
from hybrid.dynamics import inverse_dynamics
from hybrid.plant.servo import Servo
from hybrid.robot.chain import Chain

RATE, SUBSTEPS, STROKES = 500.0, 2, 3
TIME, LENGTH = 0.5, 0.03  # s and rad, usual ones one way
TURN = 0.002  # rad/s: below, the sign of a speed is not full
PERIODS = 20.0  # of the ripple, per turn
FIRST = [0.3, 0.1, 0.0, 0.0]  # gains before tuning
RUNS, CHANGE = 6, 0.02  # of a tuning: looks at the simulator, and changes of a gain

World = Callable[[np.ndarray], Any]  # arms at rest at (B, n) in a simulator


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


def in_file(file: Path, joints: Sequence[str]) -> World:
    """Arms of an MJCF file."""
    return lambda start: FileArms(file, joints, start)


def strokes(robot: Robot, rng: np.random.Generator) -> list[Motion]:
    """Motions of least jerk from rest to rest and back."""
    shape = STROKES, robot.size
    starts = 0.35 * rng.uniform(robot.q_min, robot.q_max, shape)
    far = LENGTH * rng.choice([-1.0, 1.0], shape) * rng.uniform(0.5, 1.5, shape)
    t = np.arange(round((2 * TIME + 0.1) * RATE)) / RATE
    s, back = (np.clip((t - x) / TIME, 0.0, 1.0) for x in (0.0, TIME))
    ways = [s**3 * (10 - 15 * s + 6 * s**2) for s in (s, back)]
    ways += [30 * s**2 * (1 - s) ** 2 / TIME for s in (s, back)]
    ways += [60 * s * (1 - s) * (1 - 2 * s) / TIME**2 for s in (s, back)]
    q, v, a = (x - y for x, y in zip(ways[::2], ways[1::2], strict=True))
    every = np.ones(len(t), dtype=bool)
    return [
        Motion(t, start + np.outer(q, d), np.outer(v, d), np.outer(a, d),
               np.outer(0 * q, d), every, joints=robot.joints)
        for start, d in zip(starts, far, strict=True)
    ]  # fmt: skip


def tuned(
    world: World, chain: Chain, unit: np.ndarray, servo: Servo, ways: Sequence[Motion]
) -> np.ndarray:
    """Gains with least squared tracking error in a simulator, shape (4, n).

    Gauss and Newton's, with slopes from differences; the same budget for each world.
    """
    first = np.outer(FIRST, np.ones(len(unit))).ravel()
    low = np.repeat([0.0, 0.0, -4.0, -4.0], len(unit))

    def off(x: np.ndarray) -> np.ndarray:
        gains = x.reshape(-1, 4, len(unit))
        own = tracked(world, servo, ways, fed_forward(chain, unit, ways, gains))
        return own.reshape(len(own), -1)

    def slopes(x: np.ndarray) -> np.ndarray:
        return (off(x + CHANGE * np.eye(len(x))) - off(x)).T / CHANGE

    found = least_squares(
        lambda x: off(x)[0], first, slopes, bounds=(low, 4.0), max_nfev=RUNS
    )
    return np.asarray(found.x.reshape(4, -1))


def fed_forward(
    chain: Chain, unit: np.ndarray, ways: Sequence[Motion], gains: np.ndarray
) -> np.ndarray:
    """Torque that K controllers feed forward, shape (K, M, N, n), [N·m].

    Args:
        chain: Links that the controllers know.
        unit: Torque of a gain of one, shape (n,), [N·m].
        ways: M motions.
        gains: Gains of each controller, shape (K, 4, n), beside the links' torque: of
            the sign of speed, of speed in tenths of a rad/s, and of the sine and cosine
            of the ripple.
    """
    q, v = (np.stack([getattr(m, x) for m in ways]) for x in "qv")
    rigid = [inverse_dynamics(chain, chain.inertial, m.q, m.v, m.a) for m in ways]
    turn = PERIODS * q
    parts = np.stack([np.tanh(v / TURN), v / 0.1, np.sin(turn), np.cos(turn)])
    return np.stack(rigid) + np.einsum("kpj,pmtj->kmtj", gains * unit, parts)


def tracked(
    world: World, servo: Servo, ways: Sequence[Motion], feed: np.ndarray
) -> np.ndarray:
    """Tracking errors of K controllers, shape (K, M, N, n), [rad].

    Args:
        world: Where they run.
        servo: Usual gains; the controllers have a quarter of its bandwidth.
        ways: M motions.
        feed: Torque beside that of the servo, shape (K, M, N, n), [N·m].
    """
    q, v = (np.stack([getattr(m, x) for m in ways]) for x in "qv")  # (M, N, n)
    shape = len(feed), len(ways), q.shape[2]
    start = np.broadcast_to(q[:, 0], shape).reshape(-1, shape[2]).copy()
    off = np.empty(feed.shape)
    state = world(start)
    for k in range(q.shape[1]):
        off[:, :, k] = q[:, k] - state.q.reshape(shape)
        turn = v[:, k] - state.v.reshape(shape)
        pd = servo.kp / 16 * off[:, :, k] + servo.kd / 4 * turn
        state.step((feed[:, :, k] + pd).reshape(-1, shape[2]), SUBSTEPS)
    return off
