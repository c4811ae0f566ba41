"""Turn an identified model into a simulator, and the remaining effects into a model."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.effects.payload import LinkInertia
from hybrid.errors import HybridError
from hybrid.exports.simulator.friction import typical_motion
from hybrid.exports.simulator.plan import plan
from hybrid.exports.simulator.simulator import Simulator, build_simulator
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.signals import Motion

_TEN = tuple(gain.name for gain in LinkInertia.gains)


def model_simulator(
    model: DynamicModel,
    *,
    kind: str = "mjcf",
    motions: Sequence[Motion] = (),
    folder: str | Path | None = None,
) -> Simulator:
    """Write the identified parameters of a model into the file of its arm.

    Args:
        model: An identified model; ``model.robot.path`` is the file.
        kind: ``mjcf``, ``urdf``, or ``isaaclab``, a URDF file without springs.
        motions: Motions with the speeds at which friction is fitted; by default one
            within the range of the recordings.
        folder: Folder of the new file, if it is another one.

    Raises:
        HybridError: No physically consistent links were identified.
    """
    if model.inertial is None:
        raise HybridError(
            "a simulator needs links that could be built; identify with "
            "consistent=True, on the command line --consistent"
        )
    motions = motions or (usual_motion(model),)
    parts = model.remainder.parts if model.remainder else ()
    learned = ", ".join(model.robot.joints[part.joint] for part in parts)
    return build_simulator(
        _bare(model),
        model.effects,
        kind=kind,
        motions=motions,
        folder=folder,
        notes=[f"learned remainder of {learned}"] if learned else (),
    )


def missing_model(model: DynamicModel, made: Simulator) -> DynamicModel:
    """Model of the effects that a simulator lacks.

    Exported as C it can run together with any simulator, which subtracts its torque at
    the joints. It keeps its links for effects that depend on their load, and subtracts
    their torque by negative links.

    Args:
        model: The identified model.
        made: The simulator that was built from it.
    """
    negative = [
        LinkInertia((k,), dict(zip(_TEN, (-x).tolist(), strict=True)))
        for k, x in enumerate(model.link_parameters)
        if x.any()
    ]
    return replace(model, effects=(*made.rest, *negative), simpler={})


def _bare(model: DynamicModel) -> Robot:
    """The arm with the model's links; effects have its rotors, friction and springs."""
    assert model.inertial is not None
    robot, zero = model.robot.with_inertial(model.inertial), np.zeros(model.robot.size)
    names = "damping", "frictionloss", "quadratic", "cubic", "stiffness", "knee"
    own: dict[str, Any] = dict.fromkeys(names, zero)
    own |= {"ripple": np.zeros((0, 4)), "falling": np.zeros((0, 3))}
    own |= {"coupled": np.zeros((0, 5)), "stiffening": np.zeros((0, 4))}
    return replace(robot, chain=replace(robot.chain, armature=zero), **own)


def fields_of_model(
    model: DynamicModel,
    motions: Sequence[Motion],
    kind: str = "mjcf",
    form: Robot | None = None,
) -> Robot:
    """The arm with all parameters of a model that a kind of file can express.

    Friction that is fitted rises and falls at the speeds of ``form``, if there is one.
    """
    return plan(_bare(model), model.effects, kind, motions, form).change.robot


def usual_motion(model: DynamicModel) -> Motion:
    """Random motion at all positions and speeds of the recordings of a model."""
    names = {"q_min", "q_max", "v_max"} & model.range.keys()
    limits: dict[str, Any] = {name: model.range[name] for name in names}
    if "v_max" in limits:
        limits["v_max"] = np.maximum(limits["v_max"], 1e-6)
    motion = typical_motion(replace(model.robot, **limits))
    if "v_max" not in limits:
        return motion
    # Scale to the highest speed, because a fitted curve does not extrapolate.
    return replace(motion, v=motion.v * limits["v_max"] / np.abs(motion.v).max(axis=0))
