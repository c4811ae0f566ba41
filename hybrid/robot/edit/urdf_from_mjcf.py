"""Convert MJCF to URDF: the whole tree, with the shapes that URDF can express."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.edit.document import element, text_of
from hybrid.robot.edit.skeleton import mjcf_skeleton
from hybrid.robot.edit.urdf import DRAKE, inertial_text
from hybrid.robot.mjcf import joint_frame, joint_names, matrix
from hybrid.robot.mujoco_model import compile_spec, spec_from_file
from hybrid.robot.robot import Robot
from hybrid.robot.urdf import roll_pitch_yaw

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
    import mujoco

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
        self.names, self.joints = joint_names(model), list[str]()
        self.bodies = [model.body(b).name or f"body_{b}" for b in range(model.nbody)]
        # Position of each body in its last link, which has the same orientation.
        self.shift = np.zeros((model.nbody, 3))
        self.missing: dict[str, int] = {}

    def written(self) -> tuple[str, tuple[str, ...]]:
        links = [text for b in range(self.model.nbody) for text in self._body(b)]
        head = element("robot", {"name": self.robot.name, **DRAKE})
        lines = [head.replace("/>", ">"), *links, *self.joints]
        counts = {word: getattr(self.model, n) for n, word in _MISSING.items()}
        counts = {word: n for word, n in {**counts, **self.missing}.items() if n}
        listed = ", ".join(f"{word} ({n})" for word, n in counts.items())
        notes = (f"{listed} of the MJCF file",) if listed else ()
        return "\n".join([*lines, "</robot>", ""]), notes

    def _body(self, b: int) -> Iterator[str]:
        """Links of a body; its joints are kept for the end of the file."""
        model, name = self.model, self.bodies[b]
        first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
        if b:
            parent = int(model.body_parentid[b])
            above = self.bodies[parent]
            R = matrix(model.body_quat[b])
            p = self.shift[parent] + model.body_pos[b]
            for k, joint in enumerate(range(first, first + count), 1):
                link = name if k == count else f"{name}_{k}"
                R, p = self._joint(joint, R, p, above, link)
                if k < count:
                    yield f'  <link name="{text_of(link)}"/>'
                above = link
            if not count:
                self._add_joint(f"{name}_fixed", "fixed", R, p, above, name, [])
                p = np.zeros(3)
            self.shift[b] = p
        inner = [self._inertial(b)] if model.body_mass[b] > 0 else []
        start, n = int(model.body_geomadr[b]), int(model.body_geomnum[b])
        inner += [text for g in range(start, start + n) for text in self._geom(g, b)]
        body = "".join(f"\n    {text}" for text in inner)
        yield f'  <link name="{text_of(name)}">{body}\n  </link>'

    def _joint(
        self, joint: int, R: Array, p: Array, above: str, link: str
    ) -> tuple[Array, Array]:
        """Add a joint; return the pose of the body in the link after it."""
        model, robot, name = self.model, self.robot, self.names[joint]
        if model.jnt_type[joint] not in (2, 3):
            raise RobotError(
                f"{robot.path}: joint {name!r} is free or a ball, which URDF does not "
                "have; valid are hinge and slide"
            )
        R, p, offset = joint_frame(model, joint, R, p)
        slides, limited = model.jnt_type[joint] == 2, bool(model.jnt_limited[joint])
        kind = "prismatic" if slides else "revolute" if limited else "continuous"
        limits = {"effort": 0.0, "velocity": 0.0}
        if name in robot.joints:
            j = robot.joints.index(name)
            both = {"effort": robot.tau_max[j], "velocity": robot.v_max[j]}
            both["drake:acceleration"] = robot.a_max[j]
            limits |= {key: x for key, x in both.items() if np.isfinite(x)}
        if limited:
            low, high = model.jnt_range[joint]
            limits |= {"lower": low, "upper": high}
        dof = model.jnt_dofadr[joint]
        friction = {
            "damping": model.dof_damping[dof],
            "friction": model.dof_frictionloss[dof],
        }
        inner = [
            element("axis", {"xyz": model.jnt_axis[joint]}),
            element("limit", limits),
            element("dynamics", friction),
        ]
        self._add_joint(name, kind, R, p, above, link, inner)
        return np.eye(3), -offset

    def _add_joint(
        self, name: str, kind: str, R: Array, p: Array, above: str, link: str,
        inner: list[str],
    ) -> None:  # fmt: skip
        parts = [
            _origin(R, p),
            element("parent", {"link": above}),
            element("child", {"link": link}),
            *inner,
        ]
        text = "".join(f"\n    {x}" for x in parts)
        head = f'  <joint name="{text_of(name)}" type="{kind}">'
        self.joints.append(f"{head}{text}\n  </joint>")

    def _inertial(self, b: int) -> str:
        model = self.model
        R, center = matrix(model.body_iquat[b]), self.shift[b] + model.body_ipos[b]
        about = R @ np.diag(model.body_inertia[b]) @ R.T
        return inertial_text(model.body_mass[b], center, about)

    def _geom(self, g: int, b: int) -> Iterator[str]:
        """Visual and collision elements of a geom."""
        model = self.model
        R, p = matrix(model.geom_quat[g]), self.shift[b] + model.geom_pos[g]
        parts = list(self._shapes(g, R, p))
        words = []
        if model.geom_group[g] < _FIRST_HIDDEN:
            words.append("visual")
        if model.geom_contype[g] or model.geom_conaffinity[g]:
            words.append("collision")
        for word in words:
            for R, p, shape in parts:
                inside = f"{_origin(R, p)}<geometry>{shape}</geometry>"
                if word == "visual":
                    color = element("color", {"rgba": model.geom_rgba[g]})
                    inside += f'<material name="geom_{g}">{color}</material>'
                yield f"<{word}>{inside}</{word}>"

    def _shapes(self, g: int, R: Array, p: Array) -> Iterator[tuple[Array, Array, str]]:
        """Pose and element of each shape of a geom."""
        import mujoco

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
