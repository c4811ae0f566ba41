"""Arms with position servos and one fault each, for experiments without torque.

Logged at 50 to 200 Hz with an encoder of 4096 steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from servo_plant import Arm

from hybrid.recording import Recording
from hybrid.robot import Robot

RATES = {"models/scara.xml": 200.0, "ur5": 100.0, "SO101": 50.0}  # Hz
TICK, SECONDS = 2 * np.pi / 4096, 16.0


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


def log(robot: Robot, fault: str, j: int, seed: int, rate: float) -> Recording:
    """One log of the arm with a fault at joint j."""
    t = np.arange(0.0, SECONDS, 1 / rate)
    command = commands(robot, np.random.default_rng(seed), t)
    q = np.round(Arm(robot, fault, j).moved(t, command) / TICK) * TICK
    return Recording(t, q, command=command, joints=robot.joints, source=f"{seed}")
