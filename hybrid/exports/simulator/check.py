"""Compare the torque of a simulator's file with recordings."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.errors import HybridWarning
from hybrid.identification.validation import (
    loggers,
    residuals,
    rms_torque,
    slowest_moving,
)
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.signals import Motion


def gaps(
    model: DynamicModel, file: str | Path, motions: Sequence[Motion]
) -> dict[str, Array]:
    """RMS torque error of a model, its simulator and the exported one, if joints move.

    Errors are those of the torque as the logger shows it.

    Returns:
        RMS of ``as it was``, ``exported`` and ``model``, shape (n,), [N·m].

    Warns:
        HybridWarning: The torque was low-pass filtered before it was logged.
    """
    slowest, filters = slowest_moving(model, motions), loggers(model, motions)

    def rms(predict: Callable[[Motion], Array]) -> Array:
        return rms_torque(residuals(motions, predict, filters), slowest)

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
