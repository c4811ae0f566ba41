"""Write effects and parameters into an arm's own simulator file.

What joints, links and actuators of the file can express is written exactly. Other
friction is approximated. The remaining effects are listed;
:func:`hybrid.plant.install.install` or exported C can add them.
"""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hybrid.effects import Effect
from hybrid.errors import HybridError, RobotError
from hybrid.exports.simulator.friction import FittedFriction
from hybrid.exports.simulator.plan import JOINT_FIELDS, plan
from hybrid.files import atomic_path
from hybrid.names import xml_comment
from hybrid.robot import Robot
from hybrid.robot.edit.mjcf import edit_mjcf, move_assets
from hybrid.robot.edit.source import read, source
from hybrid.robot.edit.urdf import edit_urdf, move_meshes
from hybrid.signals import Motion

_SAME = 1e-9  # of the largest value of a kind
_TOLD = 1e-3  # of a torque: what a file misses below is not told


@dataclass(frozen=True)
class Simulator:
    """An edited robot file.

    Attributes:
        text: The file.
        original: The file before.
        robot: The arm in the file.
        rest: Effects that the file lacks. Together with the file they are the arm that
            was asked for.
        notes: What the file approximates or lacks, in words.
    """

    text: bytes
    original: bytes
    robot: Robot
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
        kind: ``mjcf``, ``urdf``, or ``isaaclab``, a URDF file without springs, which
            other simulators than Gazebo do not read.
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
    if kind not in JOINT_FIELDS:
        valid = ", ".join(JOINT_FIELDS)
        raise HybridError(f"no kind {kind!r} of simulator; valid are {valid}")
    planned = plan(robot, effects, kind, motions)
    new, fields = planned.change.robot, JOINT_FIELDS[kind]
    kind = "mjcf" if kind == "mjcf" else "urdf"
    origin = source(new, kind)
    document, old = origin.document, origin.robot
    edit = edit_mjcf if kind == "mjcf" else edit_urdf
    lacks = list(edit(document, planned.change, old))
    found = read(document, old, kind)
    _check(found, new, kind, fields)
    if origin.own and folder is not None:
        move = move_assets if kind == "mjcf" else move_meshes
        move(document, Path(robot.path).parent, Path(folder))
    lacks += origin.notes
    lacks += [
        _friction_note(robot, x)
        for x in planned.friction
        if x.missed > _TOLD * x.torque or any(e.warms for e in x.effects)
    ]
    lacks += [*(effect_note(robot, effect) for effect in planned.missing), *notes]
    if lacks:
        lines = [f"Not in this file, or only nearly: {xml_comment(x)}." for x in lacks]
        comment = "\n     ".join(lines)
        document.insert_before(document.root, f"<!-- {comment} -->\n")
    return Simulator(
        text=document.edited(),
        original=document.content,
        robot=found,
        rest=(*planned.missing, *planned.corrections),
        notes=tuple(lacks),
    )


def _check(found: Robot, wanted: Robot, kind: str, fields: Sequence[str]) -> None:
    """Compare the arm in the edited file with the arm that was asked for."""
    names = {"damping", "quadratic", "cubic", "frictionloss", "stiffness"} & {*fields}
    chains = ["armature", "inertial"]
    if kind == "mjcf":
        names |= {"ripple", "falling", "coupled", "stiffening"}
        chains.append("gravity")
    if wanted.knee.any():
        names |= {"knee", "knee_speed"}
    pairs = {x: (getattr(found, x), getattr(wanted, x)) for x in names}
    pairs |= {x: (getattr(found.chain, x), getattr(wanted.chain, x)) for x in chains}
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
        f"friction of {robot.joints[x.joint]} ({ids}): {kinds} friction in its place "
        f"leaves {x.missed:.3g} of {x.torque:.3g} "
        f"{robot.chain.unit_at([x.joint], 'N·m')} RMS"
    )


def effect_note(robot: Robot, effect: Effect) -> str:
    """An effect with its joints and gains, in words."""
    joints = ", ".join(robot.joints[j] for j in effect.joints)
    unit = partial(robot.chain.unit_at, effect.unit_joints)
    gains = [f"{g.name} {effect.values[g.name]:.4g} {unit(g.unit)}"
             for g in effect.gains if effect.values[g.name]]  # fmt: skip
    return f"{effect.id} of {joints} ({', '.join(gains)})"
