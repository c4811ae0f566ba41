"""A MuJoCo loop as a user writes it, with one fault in it.

It shares nothing with the plants of this package but the robot file and the motions:
PD control with feedforward of speed in Python, held for a millisecond; faults as
torques, changes of the model, or of what is logged; logged at 500 Hz before the step.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot

STEP, HOLD, LOG = 0.0005, 2, 2  # s; steps a torque is held; torques to a logged one
DURATION, SETTLE, OFF = 10.0, 0.8, 0.02  # s; s; what the file is off by, at most
IN_MODEL = ("coulomb", "viscous", "armature", "gravity_tilt", "payload", "link_inertia",
            "elasticity", "backlash")  # fmt: skip
IN_DRIVE = ("torque_gain", "torque_offset", "saturation", "deadzone", "torque_ripple",
            "actuator_lag")  # fmt: skip
IN_TORQUE = ("nonlinear_viscous", "stribeck", "asymmetric_friction", "load_friction",
             "thermal_friction", "presliding", "spring", "contact")  # fmt: skip
IN_LOG = ("delay", "encoder_offset", "encoder_eccentricity")
IN_COMMAND = ("command_latency", "controller_gain")
KINDS = ("none", *IN_MODEL, *IN_DRIVE, *IN_TORQUE, *IN_LOG, *IN_COMMAND)


class OwnLoop:
    """An arm with one fault of usual size at a random joint.

    Args:
        robot: The file, of which link masses and friction are off by up to 2 %.
        kind: One of ``KINDS``.
        seed: Source of joint, motions and noise.
    """

    def __init__(self, robot: Robot, kind: str, seed: int) -> None:
        self.rng = np.random.default_rng([seed, KINDS.index(kind)])
        self.kind, self.j = kind, int(self.rng.integers(robot.size))
        scales = joint_scales(robot)
        self.rated = np.array([s.torque for s in scales])
        self.R, self.V = scales[self.j].torque, scales[self.j].speed
        inertia = self._inertia(robot)
        kp, kd = inertia * (10 * np.pi) ** 2, inertia * 16 * np.pi
        self.robot = replace(robot, kp=kp, kd=kd)
        spec = robot.mujoco_spec()
        for name in robot.joints:
            part = 1.0 + self.rng.uniform(-OFF, OFF, 3)
            body, joint = spec.body(name), spec.joint(name)
            body.mass *= part[0]
            body.fullinertia = np.array(body.fullinertia) * part[0]
            joint.damping[0] *= part[1]
            joint.frictionloss *= part[2]
        if kind in IN_MODEL:
            self._change(spec, inertia[self.j])
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in robot.joints]
        self.at_q = np.array([x.qposadr[0] for x in joints])
        self.at_v = np.array([x.dofadr[0] for x in joints])
        self.limit = np.inf
        if kind == "saturation":
            self.limit = float(np.quantile(np.abs(self.record().tau[:, self.j]), 0.9))

    def _inertia(self, robot: Robot) -> np.ndarray:
        model = robot.mujoco_spec().compile()
        data, full = mujoco.MjData(model), np.zeros((robot.size, robot.size))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        return np.maximum(np.diag(full), 1e-3)

    def _change(self, spec: mujoco.MjSpec, inertia: float) -> None:
        robot, name = self.robot, self.robot.joints[self.j]
        joint, body = spec.joint(name), spec.body(name)
        match self.kind:
            case "coulomb":
                joint.frictionloss += 0.05 * self.R
            case "viscous":
                joint.damping[0] += 0.06 * self.R / self.V
            case "armature":
                joint.armature += 0.5 * inertia
            case "gravity_tilt":
                g, tilt = float(np.linalg.norm(robot.chain.gravity)), np.deg2rad(3.0)
                spec.option.gravity = [g * np.sin(tilt), 0.0, -g * np.cos(tilt)]
            case "payload":
                tool = spec.body(robot.joints[-1])
                more = 0.06 * float(robot.chain.inertial[:, 0].sum())
                centre = more * np.array([0.02, -0.03, 0.08])
                tool.ipos = (np.array(tool.ipos) * tool.mass + centre) / (
                    tool.mass + more
                )
                tool.mass += more
            case "link_inertia":
                body.mass *= 1.2
                body.ipos = np.array(body.ipos) + np.array([0.02, 0.01, -0.02])
            case "elasticity" | "backlash":
                joint.armature = max(float(joint.armature), 0.15 * inertia)
                twist = body.add_joint(name="twist", axis=joint.axis)
                stiffness = inertia * (2 * np.pi * 15.0) ** 2
                twist.damping[0] = 0.03 * inertia
                if self.kind == "elasticity":
                    twist.stiffness[0] = stiffness
                    twist.damping[0] = 0.1 * np.sqrt(stiffness * inertia)
                else:
                    twist.limited, twist.range = True, [-0.0012, 0.0012]
                    twist.solref_limit = [0.002, 1.0]

    def record(self) -> Recording:
        """Follow a random motion and log it."""
        reference = random_fourier(
            self.robot, duration=DURATION, rate=1 / (STEP * HOLD), rng=self.rng
        )
        d, robot, j, n = self.data, self.robot, self.j, self.robot.size
        targets, speeds = reference.q, np.gradient(reference.q, STEP * HOLD, axis=0)
        late = 12 if self.kind == "command_latency" else 0
        kp = robot.kp * np.where(
            (self.kind == "controller_gain") & (np.arange(n) == j), 0.8, 1.0
        )
        mujoco.mj_resetData(self.model, d)
        d.qpos[self.at_q] = targets[0]
        q, tau = np.zeros((2, len(targets), n))
        state = np.zeros(2)  # of a lag, of a bristle
        for k in range(-round(SETTLE / (STEP * HOLD)), len(targets)):
            i, at = max(k, 0), max(k - late, 0)
            q[i] = self._sensed(d.qpos[self.at_q].copy())
            speed = speeds[at] if k >= 0 else np.zeros(n)
            tau[i] = kp * (targets[at] - q[i])
            tau[i] += robot.kd * (speed - d.qvel[self.at_v])
            for _ in range(HOLD):
                given = tau[i].copy()
                given[j] = self._delivered(given[j], state)
                given[j] += self._pushed(i * STEP * HOLD, state)
                d.qfrc_applied[:] = 0.0
                d.qfrc_applied[self.at_v] = given
                if self.kind == "contact" and 3.0 <= i * STEP * HOLD < 3.8:
                    self._touch()
                mujoco.mj_step(self.model, d)
        if self.kind == "delay":
            tau[8:, j] = tau[:-8, j].copy()
        t, q, tau, command = (
            x[::LOG] for x in (reference.t, q, tau, targets)
        )  # fmt: skip
        q = 2e-5 * np.round(q / 2e-5)
        tau = tau + 0.003 * self.rated * self.rng.standard_normal(tau.shape)
        return Recording(t, q, tau=tau, command=command, joints=robot.joints)

    def _sensed(self, q: np.ndarray) -> np.ndarray:
        if self.kind == "encoder_offset":
            q[self.j] += 0.03
        if self.kind == "encoder_eccentricity":
            q[self.j] += 0.012 * np.sin(q[self.j] + 0.7)
        return q

    def _delivered(self, u: float, state: np.ndarray) -> float:
        match self.kind:
            case "torque_gain":
                return u / 1.12
            case "torque_offset":
                return u - 0.04 * self.R
            case "saturation":
                return float(np.clip(u, -self.limit, self.limit))
            case "deadzone":
                return float(np.sign(u) * max(abs(u) - 0.05 * self.R, 0.0))
            case "torque_ripple":
                angle = self.data.qpos[self.at_q[self.j]]
                return float(u + 0.03 * self.R * np.sin(10.0 * angle + 1.0))
            case "actuator_lag":
                state[0] += (u - state[0]) * STEP / 0.008
                return float(state[0])
        return u

    def _pushed(self, t: float, state: np.ndarray) -> float:
        R, V, at = self.R, self.V, self.at_v[self.j]
        q, v = self.data.qpos[self.at_q[self.j]], self.data.qvel[at]
        sign = np.tanh(v / (0.002 * V))
        match self.kind:
            case "nonlinear_viscous":
                return float(-0.1 * R / V**2 * v * abs(v))
            case "stribeck":
                return float(-0.07 * R * np.exp(-((v / (0.08 * V)) ** 2)) * sign)
            case "asymmetric_friction":
                return float(-0.03 * R * abs(sign))
            case "load_friction":
                return float(-0.12 * abs(self.data.qfrc_bias[at]) * sign)
            case "thermal_friction":
                return float(-0.1 * R / V * v * np.exp(-t / 6.0))
            case "presliding":
                state[1] += STEP * (v - abs(v) * state[1] / 0.02)
                return float(-0.06 * R * state[1] / 0.02)
            case "spring":
                return float(-0.08 * R * (q - 0.2))
        return 0.0

    def _touch(self) -> None:
        jacobian = np.zeros((3, self.model.nv))
        body = self.model.body(self.robot.joints[-1]).id
        mujoco.mj_jacBody(self.model, self.data, jacobian, None, body)
        force = 0.3 * self.rated[: min(2, len(self.rated))].max()
        self.data.qfrc_applied += jacobian.T @ (force * np.array([0.5, -0.3, 0.8]))
