"""The arm's own simulator file with what was found: the one way to write it.

What a joint, a link or an actuator of the file has a place for is there, exactly. A
friction curve that it has no place for is fitted by what it has. The rest is listed,
and is what :func:`hybrid.plant.install.install` or exported C adds.
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
from hybrid.exports.simulator.friction import StandIn, is_friction, stand_in
from hybrid.exports.simulator.typical import typical_motion
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

# What a kind of file has for a joint.
_JOINT = {"mjcf": FIELDS, "urdf": ("armature", "damping", "frictionloss")}
_CURVE = {
    "mjcf": (
        "frictionloss",
        "damping",
        "quadratic",
        "cubic",
        "preload",
        "knee",
        "fall",
    ),
    "urdf": ("frictionloss", "damping"),
}
_SAME = 1e-9  # of the largest value of a kind


@dataclass(frozen=True)
class Simulator:
    """A robot file with what was found in it.

    Attributes:
        text: The file.
        original: What it was.
        robot: The arm as it is in the file.
        friction: What stands in for friction, by joint.
        rest: Effects that, added to the file's, make what was asked for.
        notes: What the file has only nearly, or not at all, in words.
    """

    text: bytes
    original: bytes
    robot: Robot
    friction: tuple[StandIn, ...]
    rest: tuple[Effect, ...]
    notes: tuple[str, ...]

    def diff(self, name: str = "robot") -> str:
        """What is new in the file, as a unified diff."""
        old, new = (
            x.decode(errors="replace").splitlines(keepends=True)
            for x in (self.original, self.text)
        )
        return "".join(difflib.unified_diff(old, new, f"a/{name}", f"b/{name}", n=1))

    def write(self, path: str | Path) -> None:
        """Write the file, and a ``.diff`` beside it.

        A URDF and an MJCF of one name may lie in the same folder.
        """
        path = Path(path)
        plain = path.suffix == ".xml"
        beside = path.with_suffix(".diff" if plain else f"{path.suffix}.diff")
        difference = self.diff(path.name)
        with atomic_path(path) as temporary:
            temporary.write_bytes(self.text)
        with atomic_path(beside) as temporary:
            temporary.write_text(difference, encoding="utf-8")


@dataclass(frozen=True)
class _Sorted:
    """Effects by how a file says them."""

    change: Edit
    friction: tuple[StandIn, ...]
    rest: tuple[Effect, ...]
    unsaid: tuple[Effect, ...]


def build_simulator(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    kind: str = "mjcf",
    motions: Sequence[Motion] = (),
    folder: str | Path | None = None,
    notes: Sequence[str] = (),
) -> Simulator:
    """The file of an arm with other numbers, and with effects put in.

    An MJCF file stays as it is but for attributes that change; ``include`` is replaced
    by what it includes. A URDF file stays one, or becomes MJCF. An arm without its file
    has links, joints and motors.

    Args:
        robot: The arm as it shall be: links, rotors, friction and springs; ``path`` is
            the file that has it as it was.
        effects: What acts on it besides.
        kind: ``mjcf`` or ``urdf``.
        motions: Motions with the speeds at which friction is fitted; a typical one
            within the arm's limits by default.
        folder: Where the file will stand, if not where it stood: meshes and pictures
            are named relative to it.
        notes: What else the file does not have, in words; all of it is in a comment at
            its top.

    Raises:
        HybridError: The kind is not known.
        RobotError: The file is of another arm, or has no place for a joint or link.
        EffectError: An effect cannot be simulated.
    """
    if kind not in _JOINT:
        raise HybridError(f"no kind {kind!r} of simulator; valid are mjcf, urdf")
    plan = _sorted(robot, effects, kind, motions)
    new = plan.change.robot
    made = source(new, kind)
    document, old = made.document, made.robot
    edit = edit_mjcf if kind == "mjcf" else edit_urdf
    said = list(edit(document, plan.change, old))
    found = read(document, old, kind)
    _check(found, new, _JOINT[kind])
    if made.own and folder is not None:
        move = move_assets if kind == "mjcf" else move_meshes
        move(document, Path(robot.path).parent, Path(folder))
    said += [*made.notes]
    said += [_fitted(robot, x) for x in plan.friction]
    said += [in_words(robot, effect) for effect in plan.unsaid] + list(notes)
    if said:
        lines = [f"Not in this file, or only nearly: {xml_comment(x)}." for x in said]
        comment = "\n     ".join(lines)
        document.put(document.tags[0].start, f"<!-- {comment} -->\n")
    return Simulator(
        text=document.written(),
        original=document.content,
        robot=found,
        friction=plan.friction,
        rest=plan.rest,
        notes=tuple(said),
    )


def said(
    robot: Robot, effects: Sequence[Effect], kind: str, motions: Sequence[Motion]
) -> Robot:
    """The arm that a file would have; see :func:`build_simulator`."""
    return _sorted(robot, effects, kind, motions).change.robot


def _sorted(
    robot: Robot, effects: Sequence[Effect], kind: str, motions: Sequence[Motion]
) -> _Sorted:
    n, inertial = robot.size, robot.chain.inertial.copy()
    gravity = robot.chain.gravity.copy()
    acting = declared_effects(replace(robot, knee=np.zeros(n)))
    for effect in effects:
        rigid = effect.rigid_change(n, robot.chain.gravity)
        if rigid is None:
            acting.append(effect)
        else:
            inertial, gravity = inertial + rigid[0], gravity + rigid[1]
    values, left = split_effects(acting, _JOINT[kind], n)
    chain = replace(robot.chain, inertial=inertial, gravity=gravity)
    rubbing = [effect for effect in left if is_friction(effect)]
    robot, rubbing = with_curves(robot, rubbing, kind == "mjcf")
    fitted = _stand_ins(replace(robot, chain=chain), rubbing, values, kind, motions)
    rest = [effect for effect in left if not is_friction(effect)]
    drives = dict[int, Actuator]()
    structure = []
    waves = [e for e in rest if isinstance(e, TorqueRipple) and kind == "mjcf"]
    rest = [e for e in rest if e not in waves]
    ripple = np.array(
        [(e.joints[0], *e.gain_values, e.values["periods"]) for e in waves]
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
    missing = [*_missing(rubbing, values, fitted, n), *_faded(waves)]
    change = Edit(new, drives, structure)
    return _Sorted(change, fitted, (*rest, *missing), tuple(rest))


def _stand_ins(
    robot: Robot,
    rubbing: Sequence[Effect],
    values: dict[str, Array],
    kind: str,
    motions: Sequence[Motion],
) -> tuple[StandIn, ...]:
    """Fit friction that has no field, joint by joint."""
    if not rubbing:
        return ()
    motions = motions or (typical_motion(robot),)
    moved = [(motion, RigidBody(robot.chain, motion)) for motion in motions]
    return tuple(
        stand_in(
            [effect for effect in rubbing if effect.joints == (j,)],
            {name: float(x[j]) for name, x in values.items()}
            | {"knee_speed": float(robot.knee_speed[j])},
            moved,
            _CURVE[kind],
        )
        for j in sorted({effect.joints[0] for effect in rubbing})
    )


def _with_fields(
    robot: Robot, values: dict[str, Array], fitted: Sequence[StandIn]
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


def _missing(
    rubbing: Sequence[Effect],
    values: dict[str, Array],
    fitted: Sequence[StandIn],
    size: int,
) -> Iterator[Effect]:
    """Friction less what stands in for it."""
    yield from rubbing
    over = {name: np.zeros(size) for name in values}
    for each in fitted:
        for name in over.keys() & each.values.keys():
            over[name][each.joint] = values[name][each.joint] - each.values[name]
    yield from effects_of_fields(over)
    for each in fitted:
        if level := each.values.get("knee", 0.0):
            yield knee(each.joint, -level, each.values["knee_speed"])
        if level := each.values.get("fall", 0.0):
            yield fall(each.joint, -level, each.values["fall_speed"])


def _faded(waves: Sequence[TorqueRipple]) -> Iterator[Effect]:
    """Ripples that fade at high speed, less those of a file, which do not."""
    for wave in waves:
        endless = TorqueRipple(wave.joints, {"periods": wave.values["periods"]})
        if wave.values["fastest"] < endless.values["fastest"]:
            yield wave
            yield endless.at({g.name: -wave.values[g.name] for g in wave.gains})


def _check(found: Robot, wanted: Robot, fields: Sequence[str]) -> None:
    """Hold the file that was written against what it should say.

    Raises:
        RobotError: They differ.
    """
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


def _fitted(robot: Robot, x: StandIn) -> str:
    ids = ", ".join(dict.fromkeys(effect.id for effect in x.effects))
    falls = x.values.get("fall", 0.0) > 0
    kinds = "dry, falling and viscous" if falls else "dry and viscous"
    return (
        f"friction of {robot.joints[x.joint]} ({ids}), as {kinds} friction "
        f"that miss {x.missed:.3g} of {x.torque:.3g} N·m RMS"
    )


def in_words(robot: Robot, effect: Effect) -> str:
    """An effect with its joints and gains."""
    joints = ", ".join(robot.joints[j] for j in effect.joints)
    gains = [f"{g.name} {effect.values[g.name]:.4g} {g.unit}" for g in effect.gains
             if effect.values[g.name]]  # fmt: skip
    return f"{effect.id} of {joints} ({', '.join(gains)})"
