"""An identified model as a simulator, and what the simulator lacks as a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.effects.payload import LinkInertia
from hybrid.errors import HybridError
from hybrid.exports.simulator.simulator import Simulator, build_simulator, said
from hybrid.exports.simulator.typical import typical_motion
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
    """The file of a model's arm with what was identified.

    Args:
        model: An identified model; ``model.robot.path`` is the file.
        kind: ``mjcf`` or ``urdf``.
        motions: Motions with the speeds at which friction is fitted; by default one
            within the range that was seen in fitting.
        folder: Where the file will stand, if not where it stood.

    Raises:
        HybridError: No physically consistent links were identified.
    """
    if model.inertial is None:
        raise HybridError(
            "a simulator needs links that could be built; identify with "
            "consistent=True, on the command line --consistent"
        )
    motions = motions or (usual_motion(model),)
    return build_simulator(
        _bare(model).with_inertial(model.inertial),
        model.effects,
        kind=kind,
        motions=motions,
        folder=folder,
        notes=learned(model),
    )


def missing_model(model: DynamicModel, made: Simulator) -> DynamicModel:
    """What has to be added to the torque of a simulator, as a model.

    Exported as C it runs beside any simulator: its torque is taken off the joints. The
    links are there for effects that depend on their load, and taken out of the sum.

    Args:
        model: What was made a simulator of.
        made: The simulator.
    """
    none = [
        LinkInertia((k,), dict(zip(_TEN, (-x).tolist(), strict=True)))
        for k, x in enumerate(model.link_parameters)
        if x.any()
    ]
    return replace(model, effects=(*made.rest, *none), simpler={})


def learned(model: DynamicModel) -> tuple[str, ...]:
    """The learned remainder in words, if there is one."""
    if model.remainder is None or not model.remainder.parts:
        return ()
    joints = [model.robot.joints[p.joint] for p in model.remainder.parts]
    return (f"learned remainder of {', '.join(joints)}",)


def _bare(model: DynamicModel) -> Robot:
    """The arm without what its file declares of its joints: effects have all of it."""
    robot, none = model.robot, np.zeros(model.robot.size)
    names = "damping", "frictionloss", "quadratic", "cubic", "stiffness", "knee"
    own: dict[str, Any] = dict.fromkeys(names, none)
    own |= {"ripple": np.zeros((0, 4)), "falling": np.zeros((0, 3))}
    return replace(robot, chain=replace(robot.chain, armature=none), **own)


def fields_of_model(
    model: DynamicModel, motions: Sequence[Motion], kind: str = "mjcf"
) -> Robot:
    """The arm with all of a model that a kind of file has a place for.

    Args:
        model: A model with links that could be built.
        motions: Motions with the speeds at which friction is fitted.
        kind: ``mjcf`` or ``urdf``.
    """
    assert model.inertial is not None
    robot = _bare(model).with_inertial(model.inertial)
    return said(robot, model.effects, kind, motions)


def usual_motion(model: DynamicModel) -> Motion:
    """A motion within the range that was seen in fitting, at all speeds of it."""
    names = {"q_min", "q_max", "v_max"} & model.range.keys()
    seen: dict[str, Any] = {name: model.range[name] for name in names}
    if "v_max" in seen:  # as fast as it was seen, however long it takes to be so
        seen["v_max"] = np.maximum(seen["v_max"], 1e-6)
    motion = typical_motion(replace(model.robot, **seen))
    if "v_max" not in seen:
        return motion
    # A curve goes astray beyond the speeds that it is fitted at.
    return replace(motion, v=motion.v * seen["v_max"] / np.abs(motion.v).max(axis=0))
