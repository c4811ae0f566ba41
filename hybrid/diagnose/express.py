"""Effects in the terms of the simulator that was diagnosed, as a MuJoCo spec."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hybrid.diagnose.gap import Gap
from hybrid.effects import Effect
from hybrid.export.simulator import build_simulator
from hybrid.robot import Robot
from hybrid.robot.edit.document import Document
from hybrid.robot.edit.mjcf import spec_of

if TYPE_CHECKING:
    import mujoco


def express(
    gap: Gap, robot: Robot, effects: Sequence[Effect]
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """A MuJoCo spec of an arm's file with effects put in.

    Args:
        gap: Motions along which dry and viscous friction should stand in for laws that
            MJCF does not have.
        robot: The arm.
        effects: Effects on it.

    Returns:
        The spec, and what it has only nearly or not at all.
    """
    made = build_simulator(robot, effects, motions=gap.motions)
    return spec_of(Document(made.text, robot.path), robot), made.notes
