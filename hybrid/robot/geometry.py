"""Cover the collision geometry of the links by capsules."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import mujoco
import numpy as np
from scipy.cluster.vq import kmeans2

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.extras import check_extra
from hybrid.names import printable
from hybrid.robot.mjcf import matrix, mujoco_tree
from hybrid.robot.mujoco_model import compile_file
from hybrid.robot.urdf import number, numbers, origin, urdf_root, urdf_tree

if TYPE_CHECKING:
    from hybrid.robot.robot import Robot

_PIECES = 2  # capsules of a mesh, because many links are bent
_LONGEST_EDGE = 0.03  # m; longer edges are cut, so that pieces follow the surface
_CIRCLE = 16  # points of a circle
_FARTHEST = 1e3  # m; larger coordinates are wrong
_MOST_TRIANGLES = 200_000


@dataclass(frozen=True, eq=False)
class Capsules:
    """Capsules that are fixed to links and together cover the arm.

    Attributes:
        link: Link of each capsule, −1 for the base, shape (C,).
        ends: End points of its axis in the link's frame, shape (C, 2, 3), [m].
        radius: Radius, shape (C,), [m].
        names: Name of the geometry that it covers, length C.
    """

    link: np.ndarray
    ends: Array
    radius: Array
    names: tuple[str, ...]


def capsules_from_robot(robot: Robot) -> Capsules:
    """Cover every collision geometry of the robot's file by capsules.

    Of an MJCF body without collision geometry, its visible one is covered.

    Every point of the geometry lies inside a capsule. Links therefore do not touch if
    their capsules do not.

    Raises:
        RobotError: The file is missing, not readable, or has no geometry of the arm.
    """
    path = Path(robot.path)
    if not path.is_file() or path.suffix.lower() == ".xacro":
        raise RobotError(
            f"{robot.name}: collision checks need the robot's URDF or MJCF file; "
            f"{path.name or 'none'} is not there, or no such file"
        )
    if path.suffix.lower() == ".urdf":
        root = urdf_root(path.read_bytes())
        tree, pieces = urdf_tree(root, path), _urdf_pieces(root, path)
    else:
        model = compile_file(path)
        tree, pieces = mujoco_tree(model, path), _mjcf_pieces(model)
    if not set(robot.joints) <= set(tree.parents):
        raise RobotError(f"{path.name} has not all joints of {robot.name}")
    places, _ = tree.places(robot.joints, robot.held)
    where = {node.body: place for node, place in places}
    found = []
    for body, points, extra, name in pieces:
        k, R, p = where[body]
        if not np.abs(points).max(initial=extra) < _FARTHEST:
            raise RobotError(
                f"{path.name}: {printable(name)!r} reaches {_FARTHEST:g} m or more"
            )
        segment, r = _covering(points @ R.T + p)
        found.append((k, segment, r + extra, name))
    if not any(k >= 0 for k, *_ in found):
        raise RobotError(
            f"{path.name} holds no collision geometry of the arm; valid is a file that "
            "has it, or motions that keep clear of nothing (no clearance, no floor)"
        )
    link, ends, radius, names = zip(*found, strict=True)
    return Capsules(np.array(link), np.array(ends), np.array(radius), names)


_STL_HEAD = 84  # bytes before the first triangle of a binary STL file
_STL_TRIANGLE = np.dtype([("normal", "<3f4"), ("corners", "<9f4"), ("color", "<u2")])
# Body, points in its frame, radius of the ball around each point, name of the geometry.
Piece = tuple[Any, Array, float, str]


def _urdf_pieces(root: Element, path: Path) -> Iterator[Piece]:
    for link in root.iterfind("link"):
        body = link.get("name", "")
        for k, collision in enumerate(link.iterfind("collision")):
            R, p = origin(collision)
            for shape in collision.iterfind("geometry"):
                for points, extra in _urdf_points(shape, path):
                    yield body, points @ R.T + p, extra, f"{body}_{k}"


def _urdf_points(shape: Element, path: Path) -> Iterator[tuple[Array, float]]:
    """Points of a shape, and the radius of the ball around each."""
    tag = shape[0].tag if len(shape) else ""
    if tag == "mesh":
        points, triangles = _mesh(_mesh_file(shape[0].get("filename", ""), path))
        points = points * numbers(shape, tag, "scale", 1.0, 1.0, 1.0)
        yield from ((x, 0.0) for x in _pieces(points, triangles))
    elif tag in ("sphere", "capsule", "cylinder", "box"):
        radius, length = (number(shape, tag, x, 0.0) for x in ("radius", "length"))
        box = numbers(shape, tag, "size", 0.0, 0.0, 0.0) / 2
        yield _points(tag, radius, length / 2, box)


def _points(kind: str, radius: float, half: float, box: Array) -> tuple[Array, float]:
    """Points of a plain shape, and the radius of the ball around each."""
    if kind == "sphere":
        return np.zeros((1, 3)), radius
    if kind == "capsule":
        return np.array([[0, 0, -half], [0, 0, half]]), radius
    if kind == "cylinder":
        angle = np.arange(_CIRCLE) * 2 * np.pi / _CIRCLE
        wide = radius / np.cos(np.pi / _CIRCLE)  # the polygon lies outside the circle
        rim = wide * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ends = [np.insert(rim, 2, z, axis=1) for z in (-half, half)]
        return np.concatenate(ends), 0.0
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(signs * box), 0.0


def _mesh_file(name: str, path: Path) -> Path:
    """Find a mesh of a URDF file; its name starts at a folder above the file."""
    inner = re.sub("^(package|file|model)://", "", name).lstrip("/")
    for folder in path.resolve().parents:
        if inner and (folder / inner).is_file():
            return folder / inner
    raise RobotError(
        f"{path.name}: no collision geometry (mesh {printable(name)!r} is not there)"
    )


def _mesh(file: Path) -> tuple[Array, np.ndarray]:
    """Points of a mesh, shape (P, 3), [m], and corners of triangles, shape (T, 3)."""
    content = file.read_bytes()
    count = (len(content) - _STL_HEAD) // _STL_TRIANGLE.itemsize
    if count > 0 and content[_STL_HEAD - 4 : _STL_HEAD] == count.to_bytes(4, "little"):
        corners = np.frombuffer(content, _STL_TRIANGLE, count, _STL_HEAD)["corners"]
        points = corners.reshape(-1, 3).astype(float)
        return points, np.arange(len(points)).reshape(-1, 3)
    check_extra("coal", "pin", f"A mesh that is no binary STL file, {file.name},")
    import coal

    try:
        mesh = coal.MeshLoader().load(str(file), np.ones(3))
    except (RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{file}: not a readable mesh ({reason})") from error
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    return mesh.vertices(), np.array([[x[0], x[1], x[2]] for x in triangles], dtype=int)


def _mjcf_pieces(model: Any) -> Iterator[Piece]:
    for g in _colliding(model):
        kind = mujoco.mjtGeom(int(model.geom_type[g]))
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[g]))
            first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            face, faces = int(mesh.faceadr[0]), int(mesh.facenum[0])
            triangles = model.mesh_face[face : face + faces]
            vertices = model.mesh_vert[first : first + count].astype(float)
            clouds = [(x, 0.0) for x in _pieces(vertices, triangles)]
        else:  # an ellipsoid is covered by its box
            size, word = model.geom_size[g], kind.name.removeprefix("mjGEOM_").lower()
            clouds = [_points(word, float(size[0]), float(size[1]), size)]
        R, body = matrix(model.geom_quat[g]), int(model.geom_bodyid[g])
        for points, extra in clouds:
            name = model.geom(g).name or f"geom_{g}"
            yield body, points @ R.T + model.geom_pos[g], extra, name


def _colliding(model: Any) -> list[int]:
    """Geoms that collide; those of a body without any are all that shows its shape."""
    solid = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    collides[[*model.pair_geom1, *model.pair_geom2]] = True  # whatever their masks
    known = np.isin(model.geom_bodyid, model.geom_bodyid[solid & collides])
    return np.flatnonzero(solid & (collides | ~known)).tolist()


def _pieces(points: Array, triangles: np.ndarray) -> Iterator[Array]:
    """Split the points of a mesh into groups; each triangle lies in one group."""
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
    if not np.ptp(middles, axis=0).any():  # one triangle has no pieces
        yield corners.reshape(-1, 3)
        return
    _, group = kmeans2(middles, _PIECES, minit="++", rng=np.random.default_rng(0))
    for k in range(_PIECES):
        if (group == k).any():
            yield corners[group == k].reshape(-1, 3)


def _halved(corners: Array, edges: Array, chosen: np.ndarray) -> Array:
    """Cut the chosen triangles in two at the middle of their longest edge."""
    part, k = corners[chosen], edges[chosen].argmax(axis=1)
    at = np.arange(len(part))
    first, second, apex = part[at, k - 1], part[at, k], part[at, (k + 1) % 3]
    middle = (first + second) / 2
    return np.concatenate(
        [np.stack([first, middle, apex], 1), np.stack([middle, second, apex], 1)]
    )


def _covering(points: Array) -> tuple[Array, float]:
    """End points and radius of a small capsule around points."""
    if len(points) <= 2:
        return np.array([points[0], points[-1]]), 0.0

    def volume(capsule: tuple[Array, float]) -> float:
        (start, end), radius = capsule
        length = float(np.linalg.norm(end - start))
        return float(np.pi * radius**2 * (length + 4 * radius / 3))

    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    # Triangles share their corners.
    points = points[np.sort(np.unique(points, axis=0, return_index=True)[1])]
    return min((_capsule_along(points, axis) for axis in axes), key=volume)


def _capsule_along(points: Array, axis: Array) -> tuple[Array, float]:
    """End points and radius of a capsule around points, along an axis."""
    along = points @ axis
    across = points - np.outer(along, axis)
    center = (across.max(axis=0) + across.min(axis=0)) / 2
    for k in range(200):  # converges to the center of the smallest enclosing circle
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
