"""Write the simulator with the findings of a diagnosis, as MJCF and as a model."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.simulator import corrected
from hybrid.diagnosis.evidence.candidates import delivered
from hybrid.diagnosis.explanations.physical import solve_physical
from hybrid.diagnosis.explanations.refit import solve_all
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import stacked_base
from hybrid.effects import Effect
from hybrid.exports.simulator.simulator import build_simulator
from hybrid.identification import DynamicModel
from hybrid.identification.preparation import standing_speed
from hybrid.plant.joint_fields import declared_effects
from hybrid.regression.data import visited
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator

SIMULATOR = "sim_fixed.xml"
MODEL = "model.json"


def write_fixed(
    result: Result, directory: str | Path, *, home: str | Path | None = None
) -> tuple[str, ...]:
    """Write ``sim_fixed.xml`` and ``model.json``.

    ``sim_fixed.xml`` is the simulator's file with the findings, and ``sim_fixed.diff``
    the difference. A comment at its top lists what MJCF cannot express;
    ``model.json`` has all findings. Without findings both are the simulator as it is.

    The folder exists. If files are moved to another folder afterwards, their ``home``,
    paths of meshes are relative to that. Findings are returned that MJCF expresses only
    approximately, or not at all.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    robot, found = fixed_simulator(result)
    folder, effects = Path(directory), (*result.baseline, *found)
    made = build_simulator(
        robot,
        effects,
        motions=result.gap.motions,
        folder=home or folder,
        notes=_servo_notes(result),
    )
    made.write(folder / SIMULATOR)
    whole = fixed_model(result.gap, robot, (*effects, *result.command))
    whole.save(folder / MODEL)
    return made.notes


def _servo_notes(result: Result) -> list[str]:
    """Servo settings found, which a motor with torque input cannot express."""
    robot, notes = result.gap.robot, []
    for effect in result.command:
        (j,), new = effect.joints, Actuator().and_then(effect.actuator)
        kp, kd = robot.kp[j] * new.stiffness, robot.kd[j] * new.damping
        setting = f"use kp = {kp:.4g} and kd = {kd:.4g}"
        if new.latency:
            setting = f"delay commands by {1000 * new.latency:.3g} ms"
        notes.append(f"{effect.id} of {robot.joints[j]}, {setting}")
    return notes


def fixed_simulator(result: Result) -> tuple[Robot, tuple[Effect, ...]]:
    """The arm with corrected numbers, and the effects on it, fitted to all samples."""
    # Where links have to give way to be physical, the effects take what they can.
    if not result.effects:
        return result.gap.robot, ()
    search, effects = result.search, list(result.effects)
    evidence, free, own = solve_all(search)
    laws = [t.candidate for t in search.terms]
    pairs = [(law.effect, i) for law, i in zip(laws, own, strict=True)]
    physical = solve_physical(evidence, search.gap.robot.chain, free.index, pairs)
    gains = [physical.of(i) for i in own]
    others = [x.fitted(y).as_reported() for x, y in zip(laws, gains, strict=True)]
    for k, other in enumerate(delivered(others)):
        if not np.array_equal(gains[k], free.of(own[k])):
            effects[k] = other
    return corrected(result.scored, effects, physical.gains[: len(search.rigid)])


def fixed_model(gap: Gap, robot: Robot, effects: Sequence[Effect]) -> DynamicModel:
    """Make the torque model of the corrected arm: links, declared effects, findings."""
    base = stacked_base(robot.chain, (), ())
    inertial = robot.chain.inertial
    return DynamicModel(
        robot=gap.robot,
        base=base.with_values(base.mapping @ inertial.ravel()),
        effects=(*declared_effects(robot), *effects),
        cutoff=gap.cutoff,
        standing=standing_speed(gap.motions),
        range=visited([gap.sampled]),
        inertial=inertial,
    )
