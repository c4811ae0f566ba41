"""The simulator with what a diagnosis found, in files that can be used at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid.diagnosis.answer.simulator import corrected
from hybrid.diagnosis.explanations.refit import solve_all
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import stacked_base
from hybrid.effects import Effect
from hybrid.exports.simulator.simulator import build_simulator
from hybrid.identification import DynamicModel
from hybrid.identification.data import visited
from hybrid.model.declared import declared_effects
from hybrid.robot import Robot

if TYPE_CHECKING:
    from hybrid.diagnosis.answer.result import Result

SIMULATOR = "sim_fixed.xml"
MODEL = "model.json"


@dataclass(frozen=True)
class Fixed:
    """A corrected simulator, written.

    Attributes:
        simulator: MuJoCo's file.
        model: The model of torque, with all that was found.
        notes: What the simulator has only nearly, or not at all, in words.
    """

    simulator: Path
    model: Path
    notes: tuple[str, ...]


def write_fixed(
    result: Result, directory: str | Path, *, home: str | Path | None = None
) -> Fixed:
    """Write ``sim_fixed.xml`` and ``model.json``.

    The XML file is the simulator's own with what was found, and ``sim_fixed.diff`` is
    the difference. What MJCF cannot express is listed in a comment at its top;
    ``model.json`` has all of it. Where nothing was found, both are the simulator as it
    stands.

    Args:
        result: A diagnosis with what led to it.
        directory: A folder that exists.
        home: Where the files will stand, if they are moved from there: meshes are named
            relative to it.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    robot, effects = fixed_simulator(result)
    effects = (*result.healthy, *effects)
    folder = Path(directory)
    made = build_simulator(
        robot,
        effects,
        motions=result.gap.motions,
        folder=home or folder,
        notes=_of_servos(result),
    )
    made.write(folder / SIMULATOR)
    effects = (*effects, *result.command)
    fixed_model(result.gap, robot, effects).save(folder / MODEL)
    return Fixed(folder / SIMULATOR, folder / MODEL, made.notes)


def _of_servos(result: Result) -> list[str]:
    """What lies between command and torque, where motors that take torque have none."""
    robot, notes = result.gap.robot, []
    for effect in result.command:
        (j,) = effect.joints
        setting = effect.setting(float(robot.kp[j]), float(robot.kd[j]))
        notes.append(f"{effect.id} of {robot.joints[j]}, {setting}")
    return notes


def fixed_simulator(result: Result) -> tuple[Robot, tuple[Effect, ...]]:
    """The arm with its own numbers corrected, and the effects that act on it.

    All numbers are those of the fit to all recordings, as they are reported.
    """
    if not result.effects:
        return result.gap.robot, ()
    _, solution, _ = solve_all(result.scored.gap, result.search)
    rigid = len(result.search.rigid)
    return corrected(result.scored, result.effects, solution.gains[:rigid])


def fixed_model(gap: Gap, robot: Robot, effects: Sequence[Effect]) -> DynamicModel:
    """What the drives report along a motion: links, what the file declares, effects.

    Args:
        gap: What was diagnosed.
        robot: The corrected arm.
        effects: The effects that act on it.
    """
    base = stacked_base(robot.chain, (), ())
    inertial = robot.chain.inertial
    return DynamicModel(
        robot=gap.robot,
        base=base.with_values(base.mapping @ inertial.ravel()),
        effects=(*declared_effects(robot), *effects),
        cutoff=gap.cutoff,
        standing=np.zeros(robot.size),
        range=visited([gap.sampled]),
        inertial=inertial,
    )
