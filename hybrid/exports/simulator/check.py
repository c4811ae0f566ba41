"""Compare the torque of a simulator's file with recordings."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.errors import HybridWarning
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.signals import Motion


def gaps(
    model: DynamicModel, file: str | Path, motions: Sequence[Motion]
) -> dict[str, Array]:
    """RMS torque error of a model, its simulator and the exported one, if joints move.

    Returns:
        RMS of ``as it was``, ``exported`` and ``model``, shape (n,), [N·m].
    """
    moving = np.concatenate(
        [(np.abs(m.v) > model.standing) & m.mask[:, None] for m in motions]
    )

    def rms(predict: Callable[[Motion], Array]) -> Array:
        error = np.concatenate([m.tau - predict(m) for m in motions])
        return np.asarray(np.sqrt(np.mean(error**2, axis=0, where=moving)))

    own = model.robot.path or model.robot
    return {
        "as it was": rms(lambda m: file_torque(own, model, m)),
        "exported": rms(lambda m: file_torque(file, model, m)),
        "model": rms(model.predict),
    }


def file_torque(file: str | Path | Robot, model: DynamicModel, motion: Motion) -> Array:
    """Inverse dynamics of a simulator along a motion, shape (N, n), [N·m].

    The model, of the same arm, says which joints it has.

    Raises:
        RobotError: The file is unreadable, or has torque that no robot describes.
    """
    joints, held = model.robot.joints, dict(model.robot.held)
    robot = file
    if not isinstance(robot, Robot):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            robot = Robot.load(robot, joints=joints, held=held)
    return simulated_torque(robot, motion, RigidBody(robot.chain, motion))
