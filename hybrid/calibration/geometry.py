"""Conversion between joint axes and modified Denavit-Hartenberg rows.

A row has the distance a and the angle α between neighbouring axes, along and about
their common normal, and the angle θ and the shift d about and along each axis. The
common normal of nearly parallel axes is ill-conditioned; there a second angle β
replaces the first axis' d: Hayati and Mirmirani 1985, doi 10.1002/rob.4620020406.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration.steps import FixedStep, Frame, Step, follow, start
from hybrid.dynamics.kinematics import frames
from hybrid.robot.chain import Chain

PARALLEL = 0.1  # sine of the angle below which two axes count as parallel


@dataclass(frozen=True)
class Geometry:
    """Steps up to and with each of n joints, and on to the frame of the last link.

    ``parallel`` says for each joint whether the axis of the next one is parallel.
    """

    rows: tuple[tuple[FixedStep | Step, ...], ...]
    last: FixedStep
    parallel: tuple[bool, ...]

    @property
    def steps(self) -> tuple[FixedStep | Step, ...]:
        """All steps in order."""
        return (*(step for row in self.rows for step in row), self.last)


def geometry_from_chain(chain: Chain) -> Geometry:
    """Rows of an arm; their parameters are named by joint, as ``theta_elbow``."""
    rotation, point, axis = (x[:, 0] for x in frames(chain, np.zeros((1, chain.size))))
    normals = _normals(axis, point, rotation[-1])
    R, origin = _axes(normals[0].x, axis[0]), point[0]
    rows: list[tuple[FixedStep | Step, ...]] = []
    lead: Sequence[FixedStep | Step] = (FixedStep(R, origin),)
    for k, normal in enumerate(normals):
        x, y, _ = R.T @ normal.x
        theta, d = float(np.arctan2(y, x)), float((normal.start - origin) @ axis[k])
        rows.append((*lead, *_joint(chain, k, theta, d, shifts=not normal.parallel)))
        R, origin = _axes(normal.x, axis[k]), normal.end
        if k + 1 < chain.size:
            lead = _normal_steps(normal, R.T @ axis[k + 1], chain.joints[k + 1])
            R = follow(
                Frame(R[None], origin[None]), lead, np.zeros((1, 0)), {}
            ).rotation[0]
    last = FixedStep(R.T @ rotation[-1], R.T @ (point[-1] - origin))
    return Geometry(tuple(rows), last, tuple(normal.parallel for normal in normals))


def chain_from_values(
    chain: Chain, geometry: Geometry, values: Mapping[str, float]
) -> Chain:
    """The arm with changed geometry: same joints and axes, other placements.

    Absent parameters are zero.
    """
    q = np.zeros((1, chain.size))
    old = new = start(q)
    rotations, origins, _ = (x[:, 0] for x in frames(chain, q))
    rotation, translation = np.empty((chain.size, 3, 3)), np.empty((chain.size, 3))
    parent, parent_origin = np.eye(3), np.zeros(3)
    for k, row in enumerate(geometry.rows):
        old, new = follow(old, row, q, {}), follow(new, row, q, values)
        # A link's own frame is fixed in the frame of its row.
        to_new = new.rotation[0] @ old.rotation[0].T
        R = to_new @ rotations[k]
        origin = new.origin[0] + to_new @ (origins[k] - old.origin[0])
        rotation[k], translation[k] = parent.T @ R, parent.T @ (origin - parent_origin)
        parent, parent_origin = R, origin
    return replace(chain, rotation=rotation, translation=translation)


@dataclass(frozen=True)
class _Normal:
    """Common normal of a joint axis and the next one, at q = 0."""

    x: Array  # direction
    start: Array  # foot on the axis
    end: Array  # foot on the next axis
    parallel: bool


def _normals(axis: Array, points: Array, last: Array) -> list[_Normal]:
    """Normals of neighbouring axes, and for the last axis a direction across it."""
    normals, point = [], points[0]
    for z, w, next_point in zip(axis[:-1], axis[1:], points[1:], strict=True):
        normals.append(_normal(z, point, w, next_point))
        point = normals[-1].end
    return [*normals, _Normal(_perpendicular(axis[-1], last), point, point, False)]


def _normal(z: Array, point: Array, w: Array, next_point: Array) -> _Normal:
    """Normal of two axes; that of parallel ones starts at the point on the first."""
    across = np.cross(z, w)
    size = float(np.linalg.norm(across))
    if size < PARALLEL:
        end = next_point + w * (z @ (point - next_point)) / (z @ w)
        a = float(np.linalg.norm(end - point))
        x = (end - point) / a if a > 1e-9 else _perpendicular(z, np.eye(3))
        return _Normal(x, point, end, True)
    x = across / size
    along = float(np.cross(next_point - point, w) @ across) / size**2
    start = point + along * z
    return _Normal(x, start, start + float((next_point - point) @ x) * x, False)


def _normal_steps(normal: _Normal, axis: Array, joint: str) -> list[Step]:
    """Steps along a common normal to the next axis, given in the row's frame."""
    x, y, z = axis.tolist()
    steps = [
        Step(0, False, float((normal.end - normal.start) @ normal.x), f"a_{joint}"),
        Step(0, True, float(np.arctan2(-y, z)), f"alpha_{joint}"),
    ]
    if normal.parallel:
        beta = float(np.arcsin(np.clip(x, -1.0, 1.0)))
        steps.append(Step(1, True, beta, f"beta_{joint}"))
    return steps


def _joint(
    chain: Chain, k: int, theta: float, d: float, *, shifts: bool
) -> tuple[Step, ...]:
    """Rotation and shift along the joint's axis, and its deflection under load."""
    name, turns = chain.joints[k], bool(chain.revolute[k])
    return (
        Step(2, True, theta, f"theta_{name}", k if turns else None),
        Step(2, False, d, f"d_{name}" if shifts else "", None if turns else k),
        Step(2, turns, parameter=f"compliance_{name}", load=k),
    )


def _axes(x: Array, z: Array) -> Array:
    return np.column_stack([x, np.cross(z, x), z])


def _perpendicular(z: Array, rotation: Array) -> Array:
    """The column of a rotation with the largest angle to z, made perpendicular to z."""
    column = rotation[:, int(np.argmin(np.abs(z @ rotation)))]
    x = column - z * (z @ column)
    unit: Array = x / np.linalg.norm(x)
    return unit
