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
        data = mujoco.MjData(model)
        data.qpos[:] = q

        def step(tau):
            data.ctrl[:] = tau
            mujoco.mj_step(model, data, HELD)
            return data.qpos, data.qvel

        return step

    return start


def of_plant(plant) -> Start:
    """The plant itself."""

    def start(q):
        real = Lockstep(plant.arm, plant.effects, q[None])

        def step(tau):
            real.step(tau[None], HELD)
            return real.q[0], real.v[0]

        return step

    return start


def error(start: Start, gains, references, limit) -> float:
    """RMS tracking error, [rad]."""
    kp, kd, off = *np.exp(gains).reshape(2, 2), []
    for r in references:
        step, q, v = start(r.q[0]), r.q[0], r.v[0]
        for goal, speed in zip(r.q, r.v, strict=True):
            tau = np.clip(kp * (goal - q) + kd * (speed - v), -limit, limit)
            try:
                q, v = step(tau)
            except HybridError:
                q = np.full(2, np.nan)
            off.append(np.nan_to_num(goal - q, nan=LOST))
            if np.abs(off[-1]).max() >= LOST:
                break
    return float(np.sqrt(np.mean(np.square(off))))
