"""The task of ``gain_transfer.py``: a controller at 100 Hz that tracks motions."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from hybrid.errors import HybridError
from hybrid.plant.lockstep import Lockstep

HELD, STEP, LOST = 10, 0.001, 10.0  # steps of a command, s, rad of a run that diverges
Start = Callable[[np.ndarray], Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]]


def of_file(text: str) -> Start:
    """A simulator from a robot file."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = STEP

    def start(q):
        datas = [mujoco.MjData(model) for _ in q]
        for data, own in zip(datas, q, strict=True):
            data.qpos[:] = own

        def step(tau):
            for data, own in zip(datas, tau, strict=True):
                data.ctrl[:] = own
                mujoco.mj_step(model, data, HELD)
            return np.array([x.qpos for x in datas]), np.array([x.qvel for x in datas])

        return step

    return start


def of_plant(plant) -> Start:
    """The plant itself."""

    def start(q):
        real = Lockstep(plant.arm, plant.effects, q)

        def step(tau):
            real.step(tau, HELD)
            return real.q.copy(), real.v.copy()

        return step

    return start


def error(start: Start, gains, references, limit) -> float:
    """RMS tracking error, [rad]."""
    kp, kd = np.exp(gains).reshape(2, 2)
    goals, speeds = (
        np.stack([getattr(r, x) for r in references], axis=1) for x in "qv"
    )  # (N, B, n)
    q, v, off = goals[0], speeds[0], []
    step = start(q)
    for goal, speed in zip(goals, speeds, strict=True):
        try:
            q, v = step(np.clip(kp * (goal - q) + kd * (speed - v), -limit, limit))
        except HybridError:
            return LOST
        off.append(goal - q)
        if not np.abs(off[-1]).max() < LOST:
            return LOST
    return float(np.sqrt(np.mean(np.square(off))))
