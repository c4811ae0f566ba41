"""Arms with position servos and one fault each, for experiments without torque.

MuJoCo's own friction and servo laws at 1 ms, logged at 50 to 200 Hz with an encoder of
4096 steps.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from hybrid.effects.backlash import Backlash
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.model import declared_spec

RATES = {"models/scara.xml": 200.0, "ur5": 100.0, "SO101": 50.0}  # Hz
STEP, TICK, SECONDS = 0.001, 2 * np.pi / 4096, 16.0
FAULTS = (
    "none", "controller_gain", "viscous", "coulomb", "armature", "saturation",
    "torque_offset", "command_latency", "encoder_offset", "stribeck", "payload",
    "spring", "deadzone", "backlash", "goal_speed", "contact", "sign",
)  # fmt: skip


def with_servos(robot: Robot) -> Robot:
    """The arm with stiff servos and some friction, where its file has none."""
    weight = np.array(
        [9.81 * robot.chain.inertial[j:, 0].sum() for j in range(robot.size)]
    )
    reach = np.linalg.norm(robot.chain.translation, axis=1)
    beyond = np.array([reach[j + 1 :].sum() + 0.1 for j in range(robot.size)])
    stall = np.where(np.isfinite(robot.tau_max), robot.tau_max, 2 * weight * beyond)
    inertia = weight / 9.81 * beyond**2
    rotor = np.maximum(robot.chain.armature, 0.3 * inertia)
    kp = stall / 0.15
    both = {"kp": kp, "kd": 0.7 * np.sqrt(kp * (inertia + rotor)), "tau_max": stall}
    dry = np.maximum(robot.frictionloss, 0.03 * stall)
    damping = np.maximum(robot.damping, 0.3 * both["kd"])
    chain = replace(robot.chain, armature=rotor)
    return replace(robot, chain=chain, frictionloss=dry, damping=damping, **both)


def commands(robot: Robot, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Two tones at every joint about the middle of its range, (N, n), [rad]."""
    middle = np.nan_to_num((robot.q_min + robot.q_max) / 2, nan=0.4, posinf=0.4)
    span = np.minimum(robot.q_max - middle, 0.8)
    size = robot.size
    tones = sum(
        rng.uniform(0.1, 0.5, size)
        * np.sin(
            2 * np.pi * rng.uniform(0.05, 0.7, size) * t[:, None]
            + rng.uniform(0, 6, size)
        )
        for _ in range(2)
    )
    return middle + np.minimum(t, 1)[:, None] * span * tones


class Arm:
    """An arm with a fault at joint j."""

    def __init__(self, robot: Robot, fault: str, j: int) -> None:
        spec = declared_spec(robot)
        if fault == "backlash":
            Backlash(joints=(j,), values={"half_width": 0.02}).edit_spec(
                spec, robot.joints
            )
        model = self.model = spec.compile()
        model.opt.timestep, n = STEP, robot.size
        self.fault, self.j, stall = fault, j, robot.tau_max[j]
        self.own = np.array([model.joint(x).qposadr[0] for x in robot.joints])
        self.late, self.zero, d = np.zeros(n), np.zeros(n), self.own[j]
        self.dead = self.falling = 0.0
        self.fastest = np.inf
        match fault:
            case "controller_gain":
                model.actuator_gainprm[j, 0] *= 0.6
                model.actuator_biasprm[j, 1] *= 0.6
            case "viscous":
                model.dof_damping[d] += robot.kd[j]
            case "coulomb":
                model.dof_frictionloss[d] += 0.06 * stall
            case "armature":
                model.dof_armature[d] *= 3.0
            case "saturation":
                model.actuator_forcerange[j] = np.array([-0.05, 0.05]) * stall
            case "torque_offset":
                model.jnt_stiffness[d], model.qpos_spring[d] = 1e-6, 0.06e6 * stall
            case "command_latency":
                self.late[j] = 0.06
            case "encoder_offset":
                self.zero[j] = 0.08
            case "stribeck":
                self.falling = 0.06 * stall
            case "payload":
                model.body_mass[-1] *= 1.8
                model.body_inertia[-1] *= 1.8
                mujoco.mj_setConst(model, mujoco.MjData(model))
            case "spring":
                model.jnt_stiffness[d] = 0.15 * stall
            case "deadzone":
                self.dead = 0.02
            case "goal_speed":
                self.fastest = 0.4
            case "contact":
                middle = (robot.q_min[j] + robot.q_max[j]) / 2
                middle = middle if np.isfinite(middle) else 0.4
                model.jnt_range[d, 1] = middle + 0.15
        self.plain = model.dof_frictionloss.copy()
        self.data = mujoco.MjData(model)

    def moved(self, t: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Positions at the times of commands, shape (N, n), [rad]."""
        j, data, model = self.j, self.data, self.model
        ways = np.ones(len(self.own))
        ways[j] = -1.0 if self.fault == "sign" else 1.0
        data.qpos[self.own], goal = (command[0] + self.zero) * ways, command[0].copy()
        goal, out = goal + self.zero, []
        parts = round((t[1] - t[0]) / STEP)
        fine = np.arange(len(t) * parts) * STEP
        asked = self.zero + np.stack(
            [
                np.interp(fine - d, t, c)
                for d, c in zip(self.late, command.T, strict=True)
            ],
            axis=1,
        )
        most = np.full(len(goal), np.inf)
        most[j] = self.fastest * STEP
        play = self.own[j] + 1 if self.fault == "backlash" else None
        for k in range(len(t)):
            gap = data.qpos[play] if play else 0.0
            out.append(data.qpos[self.own] * ways - self.zero)
            out[-1][j] += gap
            for ask in asked[k * parts : (k + 1) * parts]:
                goal = goal + np.clip(ask - goal, -most, most)
                data.ctrl[:] = goal * ways
                at = self.own[j]
                q, gap = data.qpos[at], data.qpos[play] if play else 0.0
                off = np.clip(data.ctrl[j] - q, -self.dead, self.dead)
                data.ctrl[j] -= off + gap
                if self.falling:
                    more = self.falling * np.exp(-((data.qvel[at] / 0.05) ** 2))
                    model.dof_frictionloss[at] = self.plain[at] + more
                mujoco.mj_step(model, data)
        return np.array(out)


def log(robot: Robot, fault: str, j: int, seed: int, rate: float) -> Recording:
    """One log of the arm with a fault at joint j."""
    t = np.arange(0.0, SECONDS, 1 / rate)
    command = commands(robot, np.random.default_rng(seed), t)
    q = np.round(Arm(robot, fault, j).moved(t, command) / TICK) * TICK
    return Recording(t, q, command=command, joints=robot.joints, source=f"{seed}")
