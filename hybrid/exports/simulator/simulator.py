"""Write effects and parameters into an arm's own simulator file.

What joints, links and actuators of the file can express is written exactly. Other
friction is approximated. The remaining effects are listed;
:func:`hybrid.plant.install.install` or exported C can add them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.instant import FIELDS
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.errors import HybridError, RobotError
from hybrid.exports.simulator.friction import (
    FittedFriction,
    approximate_friction,
    is_friction,
    typical_motion,
)
from hybrid.files import atomic_path
from hybrid.model.declared import declared_effects
from hybrid.names import xml_comment
from hybrid.plant.arm import overrides
from hybrid.plant.joint_fields import (
    effects_of_fields,
    fall,
    knee,
    split_effects,
    springs,
    with_curves,
)
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator, Edit
from hybrid.robot.edit.mjcf import edit_mjcf, move_assets
from hybrid.robot.edit.source import read, source
from hybrid.robot.edit.urdf import edit_urdf, move_meshes
from hybrid.signals import Motion

# Fields of a joint in each kind of file, and those that approximate friction.
_JOINT = {"mjcf": FIELDS, "urdf": ("armature", "damping", "frictionloss")}
_CURVE = {
    "mjcf": (
        "frictionloss", "damping", "quadratic", "cubic", "preload", "knee", "fall",
    ),
    "urdf": ("frictionloss", "damping"),
}  # fmt: skip
_SAME = 1e-9  # of the largest value of a kind


@dataclass(frozen=True)
class Simulator:
    """An edited robot file.

    Attributes:
        text: The file.
        original: The file before.
        robot: The arm in the file.
        friction: Approximated friction by joint.
        rest: Effects that the file lacks. Together with the file they are the arm that
            was asked for.
        notes: What the file approximates or lacks, in words.
    """

    text: bytes
    original: bytes
    robot: Robot
    friction: tuple[FittedFriction, ...]
    rest: tuple[Effect, ...]
    notes: tuple[str, ...]

    def diff(self, name: str = "robot") -> str:
        """Changes of the file as a unified diff."""
        old, new = (
            x.decode(errors="replace").splitlines(keepends=True)
            for x in (self.original, self.text)
        )
        return "".join(difflib.unified_diff(old, new, f"a/{name}", f"b/{name}", n=1))

    def write(self, path: str | Path) -> None:
        """Write the file, and its changes as a ``.diff``.

        A URDF and an MJCF file of the same name have different ``.diff`` files.
        """
        path = Path(path)
        mjcf = path.suffix == ".xml"
        diff_path = path.with_suffix(".diff" if mjcf else f"{path.suffix}.diff")
        difference = self.diff(path.name)
        with atomic_path(path) as temporary:
            temporary.write_bytes(self.text)
        with atomic_path(diff_path) as temporary:
            temporary.write_text(difference, encoding="utf-8")


@dataclass(frozen=True)
class _Plan:
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


def build_simulator(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    kind: str = "mjcf",
    motions: Sequence[Motion] = (),
    folder: str | Path | None = None,
    notes: Sequence[str] = (),
) -> Simulator:
    """Write new parameters and effects into the file of an arm.

    Only changed attributes of an MJCF file differ; ``include`` is replaced by the
    included content. A URDF file stays URDF or becomes MJCF. For an arm without a file,
    the new file has links, joints and motors.

    Args:
        robot: The arm with its new links, rotors, friction and springs; ``path`` is the
            file to edit.
        effects: Further effects.
        kind: ``mjcf`` or ``urdf``.
        motions: Motions with the speeds at which friction is fitted; by default a
            random one within the arm's limits.
        folder: Folder of the new file, if it is another one; paths of meshes and
            pictures are adapted to it.
        notes: Further notes on what the file lacks. A comment at the top of the file
            has all notes.

    Raises:
        HybridError: The kind is not known.
        RobotError: The file is of another arm, or a joint or link cannot be edited.
        EffectError: An effect cannot be simulated.
    """
    if kind not in _JOINT:
        raise HybridError(f"no kind {kind!r} of simulator; valid are mjcf, urdf")
    plan = _plan(robot, effects, kind, motions)
    new = plan.change.robot
    origin = source(new, kind)
    document, old = origin.document, origin.robot
    edit = edit_mjcf if kind == "mjcf" else edit_urdf
    lacks = list(edit(document, plan.change, old))
    found = read(document, old, kind)
    _check(found, new, _JOINT[kind])
    if origin.own and folder is not None:
        move = move_assets if kind == "mjcf" else move_meshes
        move(document, Path(robot.path).parent, Path(folder))
    lacks += [*origin.notes]
    lacks += [_friction_note(robot, x) for x in plan.friction]
    lacks += [_effect_note(robot, effect) for effect in plan.missing] + list(notes)
    if lacks:
        lines = [f"Not in this file, or only nearly: {xml_comment(x)}." for x in lacks]
        comment = "\n     ".join(lines)
        document.insert(document.tags[0].start, f"<!-- {comment} -->\n")
    return Simulator(
        text=document.edited(),
        original=document.content,
        robot=found,
        friction=plan.friction,
        rest=(*plan.missing, *plan.corrections),
        notes=tuple(lacks),
    )


def planned_robot(
    robot: Robot, effects: Sequence[Effect], kind: str, motions: Sequence[Motion]
) -> Robot:
    """The arm in the file that :func:`build_simulator` would write."""
    return _plan(robot, effects, kind, motions).change.robot


def _plan(
    robot: Robot, effects: Sequence[Effect], kind: str, motions: Sequence[Motion]
) -> _Plan:
    n, inertial = robot.size, robot.chain.inertial.copy()
    gravity = robot.chain.gravity.copy()
    acting = declared_effects(replace(robot, knee=np.zeros(n)))
    for effect in effects:
        rigid = effect.rigid_change(n, robot.chain.gravity)
        if rigid is None:
            acting.append(effect)
        else:
            inertial, gravity = inertial + rigid[0], gravity + rigid[1]
    values, others = split_effects(acting, _JOINT[kind], n)
    chain = replace(robot.chain, inertial=inertial, gravity=gravity)
    friction = [effect for effect in others if is_friction(effect)]
    robot, friction = with_curves(robot, friction, kind == "mjcf")
    moved = replace(robot, chain=chain)
    fitted = _fitted_friction(moved, friction, values, kind, motions)
    rest = [effect for effect in others if not is_friction(effect)]
    drives = dict[int, Actuator]()
    structure = []
    ripples = [e for e in rest if isinstance(e, TorqueRipple) and kind == "mjcf"]
    rest = [e for e in rest if e not in ripples]
    ripple = np.array(
        [(e.joints[0], *e.gain_values, e.values["periods"]) for e in ripples]
    ).reshape(-1, 4)
    if kind == "mjcf":
        for effect in [e for e in rest if e.actuator]:
            (j,) = effect.joints
            drives[j] = drives.get(j, Actuator()).and_then(effect.actuator)
            rest.remove(effect)
        shaped = [e for e in rest if overrides(e, "edit_spec") and not e.fields]
        structure = [e.edit_spec for e in shaped]
        rest = [e for e in rest if e not in shaped]
    new = _with_fields(replace(robot, chain=chain, ripple=ripple), values, fitted)
    corrections = (
        *_friction_error(friction, values, fitted, n),
        *_ripple_error(ripples),
    )
    return _Plan(Edit(new, drives, structure), fitted, tuple(rest), corrections)


def _fitted_friction(
    robot: Robot,
    friction: Sequence[Effect],
    values: dict[str, Array],
    kind: str,
    motions: Sequence[Motion],
) -> tuple[FittedFriction, ...]:
    """Approximate friction that has no field, joint by joint."""
    if not friction:
        return ()
    motions = motions or (typical_motion(robot),)
    moved = [(motion, RigidBody(robot.chain, motion)) for motion in motions]
    return tuple(
        approximate_friction(
            [effect for effect in friction if effect.joints == (j,)],
            {name: float(x[j]) for name, x in values.items()}
            | {"knee_speed": float(robot.knee_speed[j])},
            moved,
            _CURVE[kind],
        )
        for j in sorted({effect.joints[0] for effect in friction})
    )


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
        both = springs({"stiffness": own["stiffness"], "preload": preload})
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


def _check(found: Robot, wanted: Robot, fields: Sequence[str]) -> None:
    """Compare the arm in the edited file with the arm that was asked for."""
    names = {"damping", "quadratic", "cubic", "frictionloss", "stiffness"} & {*fields}
    names |= {"ripple", "falling"} if "preload" in fields else set()
    names |= {"knee", "knee_speed"} if wanted.knee.any() else set()
    pairs = {x: (getattr(found, x), getattr(wanted, x)) for x in names}
    chains = ["armature", "inertial", *(["gravity"] if "preload" in fields else [])]
    for x in chains:
        pairs[x] = getattr(found.chain, x), getattr(wanted.chain, x)
    for name, (x, y) in pairs.items():
        most = max(np.abs(y).max(initial=0.0), 1e-3)
        if x.shape != y.shape or np.abs(x - y).max(initial=0.0) > _SAME * most:
            raise RobotError(
                f"{wanted.path}: {name} comes out as {x.tolist()} instead of "
                f"{y.tolist()}; something else in the file sets it"
            )


def _friction_note(robot: Robot, x: FittedFriction) -> str:
    ids = ", ".join(dict.fromkeys(effect.id for effect in x.effects))
    falls = x.values.get("fall", 0.0) > 0
    kinds = "dry, falling and viscous" if falls else "dry and viscous"
    return (
        f"friction of {robot.joints[x.joint]} ({ids}), as {kinds} friction "
        f"that miss {x.missed:.3g} of {x.torque:.3g} N·m RMS"
    )


def _effect_note(robot: Robot, effect: Effect) -> str:
    joints = ", ".join(robot.joints[j] for j in effect.joints)
    gains = [f"{g.name} {effect.values[g.name]:.4g} {g.unit}" for g in effect.gains
             if effect.values[g.name]]  # fmt: skip
    return f"{effect.id} of {joints} ({', '.join(gains)})"
