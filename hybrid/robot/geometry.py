"""Capsules that cover the collision geometry of the links."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.chain import zero_frames
from hybrid.robot.compiled import compiled
from hybrid.robot.mjcf import joint_names
from hybrid.robot.mjcf import start as mujoco_start
from hybrid.robot.urdf import start as pinocchio_start

if TYPE_CHECKING:
    from hybrid.robot.robot import Robot

_PIECES = 2  # capsules of a mesh: many links are bent
_LONGEST_EDGE = 0.03  # m; longer ones are cut, so that pieces follow the surface
_CIRCLE = 16  # points of a rim
_MOST_TRIANGLES = 200_000
_BASE = -1


@dataclass(frozen=True, eq=False)
class Capsules:
    """Segments with a radius, each fixed to a link; together they cover the arm.

    Attributes:
        link: Link of each, −1 for the base, shape (C,).
        ends: End points in the link's frame, shape (C, 2, 3), [m].
        radius: Radii, shape (C,), [m].
        names: Name of the geometry that each covers, length C.
    """

    link: np.ndarray
    ends: Array
    radius: Array
    names: tuple[str, ...]


def capsules_from_robot(robot: Robot) -> Capsules:
    """Capsules around every collision geometry of the robot's file.

    Every point of the geometry lies inside, so that links whose capsules keep apart
    keep apart.

    Raises:
        RobotError: The file is gone, cannot be read, or holds no geometry of the arm.
    """
    path = Path(robot.path)
    if not path.is_file() or path.suffix.lower() == ".xacro":
        raise RobotError(
            f"{robot.name}: collision checks need the robot's URDF or MJCF file; "
            f"{path.name or 'none'} is not there, or no such file"
        )
    reader = _from_urdf if path.suffix.lower() == ".urdf" else _from_mjcf
    rotation, origin = zero_frames(robot.chain)
    link, ends, radius, names = [], [], [], []
    for joint, points, grown, name in reader(robot):
        if joint >= 0:  # from the world into the link, at zero
            points = (points - origin[joint]) @ rotation[joint]
        for segment, r in _covering(points, grown):
            link.append(joint)
            ends.append(segment)
            radius.append(r)
            names.append(name)
    if not any(k >= 0 for k in link):
        raise RobotError(f"{path.name} holds no collision geometry of the arm")
    return Capsules(np.array(link), np.array(ends), np.array(radius), tuple(names))


Piece = tuple[int, Array, float, str]  # link, points in the world, growth, name


def _from_urdf(robot: Robot) -> Iterator[Piece]:
    import pinocchio as pin

    path = Path(robot.path)
    model = pin.buildModelFromUrdf(str(path))
    # Meshes are named from the root of a package, which may lie anywhere above.
    folders = [str(parent) for parent in path.resolve().parents]
    try:
        geometry = pin.buildGeomFromUrdf(
            model, str(path), pin.GeometryType.COLLISION, package_dirs=folders
        )
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{path.name}: no collision geometry ({reason})") from error
    data = model.createData()
    pin.forwardKinematics(model, data, pinocchio_start(model, robot.held))
    for item in geometry.geometryObjects:
        place = data.oMi[item.parentJoint].act(item.placement)
        joint = int(item.parentJoint)
        while joint > 0 and model.names[joint] not in robot.joints:
            joint = int(model.parents[joint])
        link = robot.joints.index(model.names[joint]) if joint > 0 else _BASE
        for points, grown in _urdf_points(item.geometry):
            yield link, points @ place.rotation.T + place.translation, grown, item.name


def _urdf_points(shape: Any) -> Iterator[tuple[Array, float]]:
    kind = type(shape).__name__
    if kind == "Sphere":
        yield np.zeros((1, 3)), float(shape.radius)
    elif kind == "Capsule":
        yield _segment(float(shape.halfLength)), float(shape.radius)
    elif kind == "Cylinder":
        yield _cylinder(float(shape.radius), float(shape.halfLength)), 0.0
    elif kind == "Box":
        yield _box(np.ravel(shape.halfSide)), 0.0
    elif hasattr(shape, "vertices"):
        points = np.asarray(shape.vertices())
        count = getattr(shape, "num_tris", 0)
        corners = (shape.tri_indices(k) for k in range(count))
        triangles = np.array([[x[0], x[1], x[2]] for x in corners], dtype=int)
        yield from ((x, 0.0) for x in _pieces(points, triangles))


def _from_mjcf(robot: Robot) -> Iterator[Piece]:
    import mujoco

    model: Any = compiled(robot.path)
    data = mujoco.MjData(model)
    names = joint_names(model)
    if not set(robot.joints) <= set(names):
        raise RobotError(f"{Path(robot.path).name} has not all joints of {robot.name}")
    data.qpos[:] = mujoco_start(model, robot.held)
    data.qpos[model.jnt_qposadr[[names.index(x) for x in robot.joints]]] = 0.0
    mujoco.mj_kinematics(model, data)
    shape = mujoco.mjtGeom
    for g in range(model.ngeom):
        kind, size = model.geom_type[g], model.geom_size[g]
        if kind == shape.mjGEOM_PLANE:
            continue
        clouds: list[tuple[Array, float]]
        if kind == shape.mjGEOM_SPHERE:
            clouds = [(np.zeros((1, 3)), float(size[0]))]
        elif kind == shape.mjGEOM_CAPSULE:
            clouds = [(_segment(float(size[1])), float(size[0]))]
        elif kind == shape.mjGEOM_CYLINDER:
            clouds = [(_cylinder(float(size[0]), float(size[1])), 0.0)]
        elif kind == shape.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[g]))
            first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            face, faces = int(mesh.faceadr[0]), int(mesh.facenum[0])
            triangles = model.mesh_face[face : face + faces]
            vertices = model.mesh_vert[first : first + count].astype(float)
            clouds = [(x, 0.0) for x in _pieces(vertices, triangles)]
        else:  # a box, or an ellipsoid in its box
            clouds = [(_box(size), 0.0)]
        turn = data.geom_xmat[g].reshape(3, 3)
        link = _link_of_body(model, int(model.geom_bodyid[g]), names, robot.joints)
        for points, grown in clouds:
            name = model.geom(g).name or f"geom_{g}"
            yield link, points @ turn.T + data.geom_xpos[g], grown, name


def _link_of_body(
    model: Any, body: int, names: list[str], joints: tuple[str, ...]
) -> int:
    while body > 0:
        start = int(model.body_jntadr[body])
        for joint in range(start + int(model.body_jntnum[body]) - 1, start - 1, -1):
            if names[joint] in joints:
                return joints.index(names[joint])
        body = int(model.body_parentid[body])
    return _BASE


def _segment(half: float) -> Array:
    return np.array([[0, 0, -half], [0, 0, half]])


def _cylinder(radius: float, half: float) -> Array:
    angle = np.arange(_CIRCLE) * 2 * np.pi / _CIRCLE
    wide = radius / np.cos(np.pi / _CIRCLE)  # the polygon lies outside the circle
    rim = wide * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([np.insert(rim, 2, z, axis=1) for z in (-half, half)])


def _box(half: Array) -> Array:
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(signs * half)


def _pieces(points: Array, triangles: np.ndarray) -> Iterator[Array]:
    """Points of a mesh in a few groups; each triangle lies in one of them."""
    from scipy.cluster.vq import kmeans2

    if len(triangles) == 0:
        yield points
        return
    corners = points[triangles]  # (T, 3, 3)
    while len(corners) < _MOST_TRIANGLES:
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        longest = edges.max(axis=1) > _LONGEST_EDGE
        if not longest.any():
            break
        corners = np.concatenate([corners[~longest], _halved(corners, edges, longest)])
    middles = corners.mean(axis=1)
    _, group = kmeans2(middles, _PIECES, minit="++", rng=np.random.default_rng(0))
    for k in range(_PIECES):
        if (group == k).any():
            yield corners[group == k].reshape(-1, 3)


def _halved(corners: Array, edges: Array, chosen: np.ndarray) -> Array:
    """The chosen triangles, cut in two at the middle of their longest edge."""
    part, k = corners[chosen], edges[chosen].argmax(axis=1)
    at = np.arange(len(part))
    first, second, apex = part[at, k - 1], part[at, k], part[at, (k + 1) % 3]
    middle = (first + second) / 2
    return np.concatenate(
        [np.stack([first, middle, apex], 1), np.stack([middle, second, apex], 1)]
    )


def _covering(points: Array, grown: float) -> Iterator[tuple[Array, float]]:
    """A thin capsule around points that are balls of radius ``grown``."""
    if len(points) <= 2:
        yield np.array([points[0], points[-1]]), grown
        return
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    best: tuple[float, Array, float] | None = None
    for axis in axes:
        segment, radius = _capsule_along(points, axis)
        length = float(np.linalg.norm(segment[1] - segment[0]))
        volume = np.pi * radius**2 * (length + 4 * radius / 3)
        if best is None or volume < best[0]:
            best = (volume, segment, radius)
    assert best is not None
    yield best[1], best[2] + grown


def _capsule_along(points: Array, axis: Array) -> tuple[Array, float]:
    along = points @ axis
    across = points - np.outer(along, axis)
    center = (across.max(axis=0) + across.min(axis=0)) / 2
    for k in range(200):  # towards the center of the smallest circle around them
        away = across - center
        far = np.einsum("ij,ij->i", away, away).argmax()
        center = center + away[far] / (k + 2)
    center -= axis * (center @ axis)
    distance = np.linalg.norm(across - center, axis=1)
    radius = float(distance.max())
    reach = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    low, high = float((along + reach).min()), float((along - reach).max())
    middle = (low + high) / 2
    low, high = min(low, middle), max(high, middle)
    return np.stack([center + low * axis, center + high * axis]), radius
