"""An arm with position servos by MuJoCo's own laws at 1 ms, and one fault."""

from __future__ import annotations

import mujoco
import numpy as np
from servo_spoilt import spoilt

from hybrid.robot import Robot

STEP = 0.001  # s


class Arm:
    """An arm with a fault at joint j."""

    def __init__(self, robot: Robot, fault: str, j: int) -> None:
        model = self.model = spoilt(robot, fault, j)
        model.opt.timestep, n = STEP, robot.size
        self.own = np.array([model.joint(x).qposadr[0] for x in robot.joints])
        self.play = self.own[j] + 1 if fault == "backlash" else None
        self.j, self.late, self.zero, self.ways = (
            j,
            np.zeros(n),
            np.zeros(n),
            np.ones(n),
        )
        self.late[j] = 0.06 if fault == "command_latency" else 0.0  # s
        self.zero[j] = 0.08 if fault == "encoder_offset" else 0.0  # rad
        self.ways[j] = -1.0 if fault == "sign" else 1.0
        self.dead = 0.02 if fault == "deadzone" else 0.0  # rad
        self.falling = 0.06 * robot.tau_max[j] if fault == "stribeck" else 0.0  # N·m
        self.worn = 0.3 if fault == "load_friction" else 0.0
        self.most = np.full(n, np.inf)  # rad in a step
        self.most[j] = 0.4 * STEP if fault == "goal_speed" else np.inf
        self.plain = model.dof_frictionloss.copy()
        self.data = mujoco.MjData(model)

    @property
    def gap(self) -> float:
        """Position of the link behind the play, [rad]."""
        return self.data.qpos[self.play] if self.play else 0.0

    def moved(self, t: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Positions at the times of commands, shape (N, n), [rad]."""
        data, goal, out = self.data, command[0] + self.zero, []
        data.qpos[self.own] = goal * self.ways
        parts = round((t[1] - t[0]) / STEP)
        late = np.arange(len(t) * parts)[:, None] - np.round(self.late / STEP)
        last = np.maximum(late // parts, 0).astype(int)  # which a servo holds
        asked = self.zero + np.take_along_axis(command, last, axis=0)
        for k in range(len(t)):
            out.append(data.qpos[self.own] * self.ways - self.zero)
            out[-1][self.j] += self.gap
            for ask in asked[k * parts : (k + 1) * parts]:
                goal = goal + np.clip(ask - goal, -self.most, self.most)
                self._step(goal * self.ways)
        return np.array(out)

    def _step(self, goal: np.ndarray) -> None:
        data, at = self.data, self.own[self.j]
        data.ctrl[:] = goal
        off = np.clip(data.ctrl[self.j] - data.qpos[at], -self.dead, self.dead)
        data.ctrl[self.j] -= off + self.gap
        if self.falling:
            more = self.falling * np.exp(-((data.qvel[at] / 0.05) ** 2))
            self.model.dof_frictionloss[at] = self.plain[at] + more
        if self.worn:
            load = data.qfrc_bias[at] + self.model.dof_armature[at] * data.qacc[at]
            self.model.dof_frictionloss[at] = self.plain[at] + self.worn * abs(load)
        mujoco.mj_step(self.model, data)
