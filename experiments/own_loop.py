"""A MuJoCo loop as a user writes it, with a fault or two in it.

It shares nothing with the plants of this package but the robot file and the motions:
PD control with feedforward of speed in Python, held for a millisecond; faults as
torques, changes of the model, or of what is logged; logged at 500 Hz before the step.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import mujoco
import numpy as np
from own_fault import KINDS, Fault
from own_motion import Make

from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot

STEP, HOLD, LOG = 0.0005, 2, 2  # s; steps a torque is held; torques to a logged one
DURATION, SETTLE, OFF = 10.0, 0.8, 0.02  # s; s; what the file is off by, at most
NOISE = 0.003  # of the rated torque


class OwnLoop:
    """An arm with faults of usual size at random joints.

    Args:
        robot: The file, of which link masses and friction are off by up to 2 %.
        kinds: Which faults, of ``own_fault.KINDS``.
        seed: Source of joints, motions and noise.
        motion: What makes the motions.
        only: Numbers of the faults that the loop has, otherwise equal; all by default.
    """

    def __init__(
        self,
        robot: Robot,
        kinds: tuple[str, ...],
        seed: int,
        motion: Make = random_fourier,
        only: Collection[int] | None = None,
    ) -> None:
        self.motion = motion
        self.rng = np.random.default_rng([seed, *map(KINDS.index, kinds)])
        scales = joint_scales(robot)
        self.rated = np.array([s.torque for s in scales])
        joints = [int(self.rng.integers(robot.size)) for _ in kinds]
        self.faults = [
            Fault(kind, j, scales[j], self.rated)
            for k, (kind, j) in enumerate(zip(kinds, joints, strict=True))
            if only is None or k in only
        ]
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
        for fault in self.faults:
            fault.change(spec, robot, inertia[fault.j])
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        joints_in_model = [self.model.joint(name) for name in robot.joints]
        self.at_q = np.array([x.qposadr[0] for x in joints_in_model])
        self.at_v = np.array([x.dofadr[0] for x in joints_in_model])
        for fault in self.faults:
            if fault.kind == "saturation":
                usual = np.abs(self.record().tau[:, fault.j])
                fault.limit = float(np.quantile(usual, 0.9))

    @property
    def named(self) -> list[tuple[str, str]]:
        """Kind of each fault, and name of its joint; what is carried is at the last."""
        return [
            (f.kind, self.robot.joints[-1 if f.kind == "payload" else f.j])
            for f in self.faults
        ]

    def _inertia(self, robot: Robot) -> np.ndarray:
        model = robot.mujoco_spec().compile()
        data, full = mujoco.MjData(model), np.zeros((robot.size, robot.size))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        return np.maximum(np.diag(full), 1e-3)

    def record(self) -> Recording:
        """Follow a motion and log it."""
        reference = self.motion(
            self.robot, duration=DURATION, rate=1 / (STEP * HOLD), seed=self.rng
        )
        d, robot, n = self.data, self.robot, self.robot.size
        targets, speeds = reference.q, np.gradient(reference.q, STEP * HOLD, axis=0)
        kinds = {f.kind for f in self.faults}
        late = 12 if "command_latency" in kinds else 0
        kp = robot.kp.copy()
        for fault in self.faults:
            fault.begin()
            if fault.kind == "controller_gain":
                kp[fault.j] *= 0.8
        mujoco.mj_resetData(self.model, d)
        d.qpos[self.at_q] = targets[0]
        q, tau = np.zeros((2, len(targets), n))
        for k in range(-round(SETTLE / (STEP * HOLD)), len(targets)):
            i, at = max(k, 0), max(k - late, 0)
            q[i] = d.qpos[self.at_q]
            for fault in self.faults:
                fault.sense(q[i])
            speed = speeds[at] if k >= 0 else np.zeros(n)
            tau[i] = kp * (targets[at] - q[i])
            tau[i] += robot.kd * (speed - d.qvel[self.at_v])
            for _ in range(HOLD):
                given = tau[i].copy()
                d.qfrc_applied[:] = 0.0
                for fault in self.faults:
                    self._act(fault, given, i * STEP * HOLD)
                d.qfrc_applied[self.at_v] += given
                mujoco.mj_step(self.model, d)
        for fault in self.faults:
            if fault.kind == "delay":
                tau[8:, fault.j] = tau[:-8, fault.j].copy()
        t, q, tau, command = (
            x[::LOG] for x in (reference.t, q, tau, targets)
        )  # fmt: skip
        q = 2e-5 * np.round(q / 2e-5)
        tau = tau + NOISE * self.rated * self.rng.standard_normal(tau.shape)
        return Recording(t, q, tau=tau, command=command, joints=robot.joints)

    def _transmitted(self, j: int) -> float:
        """Torque that a gear passes on to the links, [N·m], as of the last step."""
        d, k, inertial = self.data, self.at_v[j], np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, d, inertial, d.qacc)
        rotor = self.model.dof_armature[k] * d.qacc[k]
        return float(inertial[k] - rotor + d.qfrc_bias[k])

    def _act(self, fault: Fault, given: np.ndarray, t: float) -> None:
        """What a fault makes of the torques that the drives are given, for a step."""
        d, j = self.data, fault.j
        q, v = float(d.qpos[self.at_q[j]]), float(d.qvel[self.at_v[j]])
        given[j] = fault.delivered(given[j], q, STEP)
        given[j] += fault.pushed(t, q, v, self._transmitted(j), STEP)
        if fault.touches(t):
            jacobian = np.zeros((3, self.model.nv))
            body = self.model.body(self.robot.joints[-1]).id
            mujoco.mj_jacBody(self.model, d, jacobian, None, body)
            d.qfrc_applied += jacobian.T @ fault.force
