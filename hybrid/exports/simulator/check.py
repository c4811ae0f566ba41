"""A simulator's file held against recordings, as the simulator computes torque."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.errors import HybridWarning
from hybrid.model.dynamic_model import DynamicModel
from hybrid.plant.inverse import file_inverse_dynamics
from hybrid.robot import Robot
from hybrid.signals import Motion


def gaps(
    model: DynamicModel, file: str | Path, motions: Sequence[Motion]
) -> dict[str, Array]:
    """RMS of the torque that a model and simulators miss, where a joint moves.

    Args:
        model: A model; ``model.robot`` is the simulator as it was.
        file: The simulator that was written of it, ``.xml`` or ``.urdf``.
        motions: Motions with torque.

    Returns:
        By ``as it was``, ``exported`` and ``model``, shape (n,), [N·m].
    """
    own = model.robot.path or model.robot
    return {
        "as it was": left(
            motions, [file_torque(own, model, m) for m in motions], model
        ),
        "exported": left(
            motions, [file_torque(file, model, m) for m in motions], model
        ),
        "model": left(motions, [model.predict(m) for m in motions], model),
    }


def left(
    motions: Sequence[Motion], torque: Sequence[Array], model: DynamicModel
) -> Array:
    """RMS of what torques are off, where a joint moves, shape (n,), [N·m]."""
    off = np.concatenate([m.tau - x for m, x in zip(motions, torque, strict=True)])
    moving = [(np.abs(m.v) > model.standing) & m.mask[:, None] for m in motions]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0, where=np.concatenate(moving))))


def file_torque(file: str | Path | Robot, model: DynamicModel, motion: Motion) -> Array:
    """Torque that a simulator's joints need along a motion, shape (N, n), [N·m].

    MuJoCo itself computes that of an MJCF file, with tendons and all.

    Args:
        file: The simulator, or the arm that it has.
        model: Of the same arm.
        motion: Motion of N samples.
    """
    joints, held = model.robot.joints, dict(model.robot.held)
    if not isinstance(file, Robot) and Path(file).suffix in (".xml", ".mjcf"):
        return file_inverse_dynamics(file, joints, motion, held)
    robot = file
    if not isinstance(robot, Robot):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            robot = Robot.load(robot, joints=joints, held=held)
    torque = robot.joint_torque(motion.q, motion.v, motion.a)
    torque += robot.dry_friction(motion.v)
    return torque + RigidBody(robot.chain, motion).load
