"""Conversion between joint axes and modified Denavit-Hartenberg rows.

A row has the distance a and the angle α between neighbouring axes, along and about
their common normal, and the angle θ and the shift d about and along each axis. The
common normal of nearly parallel axes is ill-conditioned; there a second angle β
replaces the first axis' d: Hayati and Mirmirani 1985, doi 10.1002/rob.4620020406.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration.steps import FixedStep, Step, follow, start
from hybrid.robot.chain import Chain, zero_frames
from hybrid.robot.spatial import rotation_from_axis_angle

PARALLEL = 0.1  # sine of the angle below which two axes count as parallel


@dataclass(frozen=True)
class Geometry:
    """An arm from its base frame to the frame of its last link.

    Attributes:
        rows: Steps up to each joint, including it, length n.
        last: Step from the frame after the last row to the last link's frame.
        parallel: Whether the axis of the next joint is parallel, for each joint.
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
    rotation, point = zero_frames(chain)
    axis = np.einsum("kij,kj->ki", rotation, chain.axis)
    rows: list[tuple[FixedStep | Step, ...]] = []
    frames = _frames(axis, point, rotation[-1])
    R, origin = frames[0].rotation, point[0]
    lead: list[FixedStep | Step] = [FixedStep(R, origin)]
    parallel = []
    for k, frame in enumerate(frames):
        x, y = R.T @ frame.rotation[:, 0] @ np.eye(3)[:, :2]
        theta = float(np.arctan2(y, x))
        d = float((frame.origin - origin) @ axis[k])
        next_parallel = frame.beta is not None
        rows.append((*lead, *_joint(chain, k, theta, d, shifts=not next_parallel)))
        parallel.append(next_parallel)
        if k + 1 < chain.size:
            lead, R, origin = _normal_steps(frame, chain.joints[k + 1])
    D = frames[-1].rotation
    last = FixedStep(D.T @ rotation[-1], D.T @ (point[-1] - frames[-1].origin))
    return Geometry(tuple(rows), last, tuple(parallel))


def chain_from_values(
    chain: Chain, geometry: Geometry, values: Mapping[str, float]
) -> Chain:
    """The arm with changed geometry: same joints and axes, other placements.

    Args:
        chain: The arm that ``geometry`` was made from.
        geometry: Its rows.
        values: Parameters by name; absent ones are zero.
    """
    q = np.zeros((1, chain.size))
    old = new = start(q)
    rotations, origins = zero_frames(chain)
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
class _RowFrame:
    """A frame on a joint axis, x along the normal to the next axis, at q = 0."""

    rotation: Array
    origin: Array
    a: float = 0.0
    alpha: float = 0.0
    beta: float | None = None


def _frames(axis: Array, points: Array, last: Array) -> list[_RowFrame]:
    frames, point = [], points[0]
    for k in range(len(axis) - 1):
        frame, point = _common_normal(axis[k], point, axis[k + 1], points[k + 1])
        frames.append(frame)
    frames.append(_RowFrame(_axes(_perpendicular(axis[-1], last), axis[-1]), point))
    return frames


def _common_normal(
    z: Array, point: Array, w: Array, next_point: Array
) -> tuple[_RowFrame, Array]:
    """The row frame on axis z, and the foot of the normal on the next axis w."""
    across = np.cross(z, w)
    size = float(np.linalg.norm(across))
    if size < PARALLEL:
        target = next_point + w * (z @ (point - next_point)) / (z @ w)
        offset = target - point
        a = float(np.linalg.norm(offset))
        x = offset / a if a > 1e-9 else _perpendicular(z, np.eye(3))
        origin = point
    else:
        x = across / size
        along = float(np.cross(next_point - point, w) @ across) / size**2
        origin = point + along * z
        a = float((next_point - point) @ x)
        target = origin + a * x
    R = _axes(x, z)
    wx, wy, wz = R.T @ w
    beta = float(np.arcsin(np.clip(wx, -1.0, 1.0))) if size < PARALLEL else None
    return _RowFrame(R, origin, a, float(np.arctan2(-wy, wz)), beta), target


def _normal_steps(
    frame: _RowFrame, joint: str
) -> tuple[list[FixedStep | Step], Array, Array]:
    """Steps along the common normal, and the frame after them at q = 0."""
    steps: list[FixedStep | Step] = [
        Step(0, False, frame.a, f"a_{joint}"),
        Step(0, True, frame.alpha, f"alpha_{joint}"),
    ]
    R = frame.rotation @ rotation_from_axis_angle(np.eye(3)[0], frame.alpha)
    if frame.beta is not None:
        steps.append(Step(1, True, frame.beta, f"beta_{joint}"))
        R = R @ rotation_from_axis_angle(np.eye(3)[1], frame.beta)
    return steps, R, frame.origin + frame.a * frame.rotation[:, 0]


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
