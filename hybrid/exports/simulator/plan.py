"""Decide how a kind of file expresses effects: exactly, approximately, or not."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.instant import FIELDS
from hybrid.effects.stiffening_spring import StiffeningSpring
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.exports.simulator.friction import (
    FittedFriction,
    approximate_friction,
    is_friction,
    typical_motion,
)
from hybrid.plant.arm import overrides
from hybrid.plant.joint_fields import (
    coupled_rows,
    declared_effects,
    effects_of_fields,
    fall,
    knee,
    soft_springs,
    split_effects,
    with_curves,
)
from hybrid.plant.reference import limits
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator, Edit
from hybrid.signals import Motion

# Fields of a joint in each kind of file.
JOINT_FIELDS = {
    "mjcf": tuple(FIELDS),
    "urdf": ("armature", "damping", "frictionloss", "stiffness", "preload"),
    "isaaclab": ("armature", "damping", "frictionloss"),
}  # fmt: skip
# Fields that approximate friction: everywhere, and in MJCF.
_CURVE = ("frictionloss", "damping")
_CURVE_OF_MJCF = (*_CURVE, "quadratic", "cubic", "preload", "knee", "fall")


@dataclass(frozen=True)
class Plan:
    """Effects sorted by how a file expresses them.

    Attributes:
        change: What the file expresses exactly.
        friction: Friction that it approximates.
        missing: Effects that it does not express.
        corrections: True friction less the approximation.
    """

    change: Edit
    friction: tuple[FittedFriction, ...]
    missing: tuple[Effect, ...]
    corrections: tuple[Effect, ...]


def plan(
    robot: Robot,
    effects: Sequence[Effect],
    kind: str,
    motions: Sequence[Motion],
    form: Robot | None = None,
) -> Plan:
    """Decide how a file of an arm expresses it and further effects.

    Friction that is fitted rises and falls at the speeds of ``form``, if there is one.
    """
    n, mjcf = robot.size, kind == "mjcf"
    inertial, gravity = robot.chain.inertial, robot.chain.gravity
    acting = declared_effects(replace(robot, knee=np.zeros(n)))
    for effect in effects:
        rigid = effect.rigid_change(n, robot.chain.gravity)
        if rigid is None:
            acting.append(effect)
        else:
            inertial, gravity = inertial + rigid[0], gravity + rigid[1]
    values, others = split_effects(acting, JOINT_FIELDS[kind], n)
    if kind == "urdf":
        others += _offsets(values)
    chain = replace(robot.chain, inertial=inertial, gravity=gravity)
    friction = [effect for effect in others if is_friction(effect)]
    robot, friction = with_curves(robot, friction, mjcf)
    fitted = _fitted_friction(
        replace(robot, chain=chain), friction, values, kind, motions, form
    )
    rest = [effect for effect in others if not is_friction(effect)]
    own = rest if mjcf else []
    ripples = [e for e in own if isinstance(e, TorqueRipple)]
    rotors = [e for e in own if isinstance(e, TransmissionCoupling)]
    motors = [e for e in own if e.actuator]
    springs = [e for e in own if isinstance(e, StiffeningSpring)]
    known: list[Effect] = [*ripples, *rotors, *motors, *springs]
    own = [e for e in own if not e.fields and e not in known]
    shaped = [e for e in own if overrides(e, "edit_spec")]
    coupled, below = coupled_rows(rotors)
    rows = [(e.joints[0], *e.gain_values, e.values["periods"]) for e in ripples]
    ripple = np.array(rows).reshape(-1, 4)
    rows = [(e.joints[0], *e.gain_values, *e.shape_values.values()) for e in springs]
    stiff = np.array(rows).reshape(-1, 4)
    arm = replace(robot, chain=chain, ripple=ripple, coupled=coupled, stiffening=stiff)
    new = _with_fields(arm, values, fitted)
    error = [*_friction_error(friction, values, fitted, n), *_ripple_error(ripples)]
    return Plan(
        change=Edit(new, drive_changes(motors), [e.edit_spec for e in shaped]),
        friction=fitted,
        missing=(*(e for e in rest if e not in known and e not in shaped), *below),
        corrections=tuple(error),
    )


def _offsets(values: dict[str, Array]) -> list[Effect]:
    """Remove preloads without a spring from joint fields, as offsets of torque.

    A URDF file has no word for a constant torque: a soft spring in Gazebo's tags would
    be one in a single simulator.
    """
    alone = np.where(values["stiffness"] > 0, 0.0, values["preload"])
    values["preload"] -= alone
    return [
        TorqueOffset((j,), {"level": float(alone[j])})
        for j in np.flatnonzero(alone).tolist()
    ]


def drive_changes(effects: Sequence[Effect]) -> dict[int, Actuator]:
    """Changes of the actuator of each joint by effects."""
    drives = dict[int, Actuator]()
    for effect in effects:
        if effect.actuator:
            (j,) = effect.joints
            drives[j] = drives.get(j, Actuator()).and_then(effect.actuator)
    return drives


def _fitted_friction(
    robot: Robot,
    friction: Sequence[Effect],
    values: dict[str, Array],
    kind: str,
    motions: Sequence[Motion],
    form: Robot | None,
) -> tuple[FittedFriction, ...]:
    """Approximate friction that has no field, joint by joint."""
    if not friction:
        return ()
    motions = motions or (typical_motion(robot),)
    moved = [(motion, RigidBody(robot.chain, motion)) for motion in motions]
    highest = limits(robot)[2]
    return tuple(
        approximate_friction(
            [effect for effect in friction if effect.joints == (j,)],
            {name: float(x[j]) for name, x in values.items()}
            | {"knee_speed": float(robot.knee_speed[j])},
            moved,
            _CURVE_OF_MJCF if kind == "mjcf" else _CURVE,
            float(highest[j]),
            _form(form, j),
        )
        for j in sorted({effect.joints[0] for effect in friction})
    )


def _form(robot: Robot | None, joint: int) -> dict[str, float] | None:
    """Speeds at which the friction of a joint rises and falls; 0 for none."""
    if robot is None:
        return None
    falls = {int(j): speed for j, _, speed in robot.falling.tolist()}
    rises = robot.knee_speed[joint] if robot.knee[joint] else 0.0
    return {"knee_speed": float(rises), "fall_speed": falls.get(joint, 0.0)}


def _with_fields(
    robot: Robot, values: dict[str, Array], fitted: Sequence[FittedFriction]
) -> Robot:
    """The arm with values of its joints' fields."""
    own: dict[str, Any] = {name: x.copy() for name, x in values.items()}
    own |= {"knee": robot.knee.copy(), "knee_speed": robot.knee_speed.copy()}
    for each in fitted:
        for name, x in each.values.items():
            if name in own:
                own[name][each.joint] = x
    armature, preload = own.pop("armature"), own.pop("preload", None)
    if preload is not None:
        before = -robot.stiffness * robot.springref
        kept = (own["stiffness"] == robot.stiffness) & (preload == before)
        both = soft_springs(own["stiffness"], preload)
        own["stiffness"] = np.where(kept, robot.stiffness, both[0])
        own["springref"] = np.where(kept, robot.springref, both[1])
    falling = [
        (x.joint, x.values["fall"], x.values["fall_speed"])
        for x in fitted if x.values.get("fall")
    ]  # fmt: skip
    own["falling"] = np.array([*robot.falling.tolist(), *falling]).reshape(-1, 3)
    return replace(robot, chain=replace(robot.chain, armature=armature), **own)


def _friction_error(
    friction: Sequence[Effect],
    values: dict[str, Array],
    fitted: Sequence[FittedFriction],
    size: int,
) -> Iterator[Effect]:
    """True friction less its approximation."""
    yield from friction
    error = {name: np.zeros(size) for name in values}
    for each in fitted:
        for name in error.keys() & each.values.keys():
            error[name][each.joint] = values[name][each.joint] - each.values[name]
    yield from effects_of_fields(error)
    for each in fitted:
        if level := each.values.get("knee", 0.0):
            yield knee(each.joint, -level, each.values["knee_speed"])
        if level := each.values.get("fall", 0.0):
            yield fall(each.joint, -level, each.values["fall_speed"])


def _ripple_error(ripples: Sequence[TorqueRipple]) -> Iterator[Effect]:
    """Ripples that vanish at high speed, less those of the file, which do not."""
    for ripple in ripples:
        endless = TorqueRipple(ripple.joints, {"periods": ripple.values["periods"]})
        if ripple.values["fastest"] < endless.values["fastest"]:
            yield ripple
            yield endless.at({g.name: -ripple.values[g.name] for g in ripple.gains})
