"""Convert MJCF to URDF: the whole tree, with the shapes that URDF can express."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.build import mjcf_skeleton
from hybrid.robot.edit.document import element, text_of
from hybrid.robot.edit.urdf import DRAKE, inertial_text
from hybrid.robot.mjcf import joint_numbers, matrix, mujoco_tree
from hybrid.robot.mujoco_model import compile_spec, spec_from_file
from hybrid.robot.robot import Robot
from hybrid.robot.tree import Node
from hybrid.robot.urdf import UNLIMITED, roll_pitch_yaw

_FIRST_HIDDEN = 3  # lowest group of geoms that MuJoCo does not show
_FORMATS = (".stl", ".obj", ".dae")
# Elements that URDF cannot express, by MuJoCo's counts.
_MISSING = {
    "nu": "actuators", "ntendon": "tendons", "neq": "equality constraints",
    "nsite": "sites", "nsensor": "sensors", "nkey": "keyframes",
    "nexclude": "contact excludes", "ncam": "cameras", "nlight": "lights",
}  # fmt: skip


def urdf_from_mjcf(robot: Robot) -> tuple[str, tuple[str, ...]]:
    """Convert a robot's MJCF file to URDF; without a file, only links and joints.

    Each body becomes a link of the same name, or one link for each of its joints. Joint
    positions keep their zero.

    Returns:
        The URDF file, and what it lacks, in words.
    """
    path = Path(robot.path)
    if path.suffix.lower() in (".xml", ".mjcf") and path.is_file():
        spec = spec_from_file(path)
    else:
        spec = mujoco.MjSpec.from_string(mjcf_skeleton(robot))
    spec.compiler.discardvisual = False
    model, _ = compile_spec(spec, robot.path)
    return _Writer(model, spec, robot).written()


class _Writer:
    def __init__(self, model: Any, spec: Any, robot: Robot) -> None:
        self.model, self.spec, self.robot = model, spec, robot
        self.links, self.joints = list[str](), list[str]()
        self.frames: list[tuple[str, Array]] = []  # of each node: link, position in it
        self.missing: dict[str, int] = {}

    def written(self) -> tuple[str, tuple[str, ...]]:
        joints: list[Node] = []  # of the next body
        for node in mujoco_tree(self.model, self.robot.path).nodes:
            if node.joint:
                joints.append(node)
            else:
                self._body(node, joints)
                joints = []
        head = element("robot", {"name": self.robot.name, **DRAKE})
        lines = [head.replace("/>", ">"), *self.links, *self.joints]
        counts = {word: getattr(self.model, n) for n, word in _MISSING.items()}
        counts |= self.missing
        listed = ", ".join(f"{word} ({n})" for word, n in counts.items() if n)
        notes = (f"{listed} of the MJCF file",) if listed else ()
        return "\n".join([*lines, "</robot>", ""]), notes

    def _body(self, body: Node, joints: list[Node]) -> None:
        """Add the joints of a body, and a link behind each."""
        name = self.model.body(body.body).name or f"body_{body.body}"
        for k, joint in enumerate(joints, 1):
            link = name if k == len(joints) else f"{name}_{k}"
            self._joint(joint, joint.joint, link)
            if link != name:
                self.links.append(f'  <link name="{text_of(link)}"/>')
        if joints or body.parent < 0:  # the last link has the frame of its joint
            self.frames.append((name, body.translation))
        else:
            self._joint(body, f"{name}_fixed", name)
        shift = self.frames[-1][1]
        inner = []
        if body.mass > 0:
            inner = [inertial_text(body.mass, shift + body.center, body.inertia)]
        for g in np.flatnonzero(self.model.geom_bodyid == body.body).tolist():
            inner += self._geom(g, shift)
        text = "".join(f"\n    {x}" for x in inner)
        self.links.append(f'  <link name="{text_of(name)}">{text}\n  </link>')

    def _joint(self, node: Node, name: str, link: str) -> None:
        """Add a joint to a link, which has its frame."""
        above, p = self.frames[node.parent]
        self.frames.append((link, np.zeros(3)))
        parts = [
            _origin(node.rotation, p + node.translation),
            element("parent", {"link": above}),
            element("child", {"link": link}),
        ]
        kind, inner = self._movement(node) if node.joint else ("fixed", [])
        text = "".join(f"\n    {x}" for x in parts + inner)
        head = f'  <joint name="{text_of(name)}" type="{kind}">'
        self.joints.append(f"{head}{text}\n  </joint>")

    def _movement(self, node: Node) -> tuple[str, list[str]]:
        """Type of a joint, and its axis, limits and friction."""
        model, robot, name = self.model, self.robot, node.joint
        if node.kind:
            raise RobotError(
                f"{robot.path}: joint {name!r} is free or a ball, which URDF does not "
                "have; valid are hinge and slide"
            )
        (joint,) = joint_numbers(model, [name])
        limited, dof = bool(model.jnt_limited[joint]), model.jnt_dofadr[joint]
        turns = "revolute" if limited else "continuous"
        limits = {"effort": UNLIMITED, "velocity": UNLIMITED}
        if name in robot.joints:
            j = robot.joints.index(name)
            declared = {
                "effort": robot.tau_max[j], "velocity": robot.v_max[j],
                "drake:acceleration": robot.a_max[j],
            }  # fmt: skip
            limits |= {key: x for key, x in declared.items() if np.isfinite(x)}
        if limited:
            low, high = model.jnt_range[joint]
            limits |= {"lower": low, "upper": high}
        damping, friction = model.dof_damping[dof], model.dof_frictionloss[dof]
        return turns if node.revolute else "prismatic", [
            element("axis", {"xyz": node.axis}),
            element("limit", limits),
            element("dynamics", {"damping": damping, "friction": friction}),
        ]

    def _geom(self, g: int, shift: Array) -> Iterator[str]:
        """Visual and collision elements of a geom."""
        model = self.model
        R, p = matrix(model.geom_quat[g]), shift + model.geom_pos[g]
        shapes = [
            f"{_origin(R, p)}<geometry>{x}</geometry>"
            for R, p, x in self._shapes(g, R, p)
        ]
        if model.geom_group[g] < _FIRST_HIDDEN:
            color = element("color", {"rgba": model.geom_rgba[g]})
            material = f'<material name="geom_{g}">{color}</material>'
            yield from (f"<visual>{x}{material}</visual>" for x in shapes)
        if model.geom_contype[g] or model.geom_conaffinity[g]:
            yield from (f"<collision>{x}</collision>" for x in shapes)

    def _shapes(self, g: int, R: Array, p: Array) -> Iterator[tuple[Array, Array, str]]:
        """Pose and element of each shape of a geom."""
        model, kinds = self.model, mujoco.mjtGeom
        kind, size = kinds(int(model.geom_type[g])), model.geom_size[g]
        ball = element("sphere", {"radius": size[0]})
        if kind == kinds.mjGEOM_SPHERE:
            yield R, p, ball
        elif kind == kinds.mjGEOM_BOX:
            yield R, p, element("box", {"size": 2.0 * size})
        elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            given = {"radius": size[0], "length": 2.0 * size[1]}
            yield R, p, element("cylinder", given)
            if kind == kinds.mjGEOM_CAPSULE:
                yield R, p + size[1] * R[:, 2], ball
                yield R, p - size[1] * R[:, 2], ball
        elif kind == kinds.mjGEOM_MESH and (file := self._file(g)):
            mesh = int(model.geom_dataid[g])
            R = R @ matrix(model.mesh_quat[mesh]).T
            given = {"filename": file, "scale": model.mesh_scale[mesh]}
            yield R, p - R @ model.mesh_pos[mesh], element("mesh", given)
        else:
            word = f"{kind.name.removeprefix('mjGEOM_').lower()} geoms"
            self.missing[word] = self.missing.get(word, 0) + 1

    def _file(self, g: int) -> str:
        """Path of a geom's mesh from the MJCF file; empty if URDF lacks its format."""
        number = int(self.model.geom_dataid[g])
        (mesh,) = (x for x in self.spec.meshes if x.id == number)
        file = mesh.file
        if Path(file).suffix.lower() not in _FORMATS:
            return ""
        return str((Path(mesh.compiler.meshdir) / file).as_posix())


def _origin(R: Array, p: Array) -> str:
    return element("origin", {"xyz": p, "rpy": roll_pitch_yaw(R)})
