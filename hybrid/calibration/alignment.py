"""Initial estimates of the frames of instrument, base and tool.

Linear least squares finds the entries of an arbitrary matrix, and the nearest rotation
replaces it: Shah 2013, doi 10.1115/1.4024473. It needs no initial estimate.
"""

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.steps import FixedStep, Frame

IDENTITY = FixedStep(np.eye(3), np.zeros(3))


def align(
    flange: Frame, data: Measurements, *, base: bool = True, tool: bool = True
) -> tuple[FixedStep, tuple[FixedStep, ...], Array]:
    """Estimate base and tool frames, or stations, from nominal poses of the flange.

    A known base is the instrument's frame, and a known tool the flange.

    Returns:
        Base of the arm in the instrument's frame, frame of each measured point in the
        flange's frame, and stations of a distance meter in the base frame, shape
        (s, 3), [m].
    """
    if data.distance is not None:
        return IDENTITY, (IDENTITY,), _stations(flange.origin, data.distance)
    points = data.position
    if data.rotation is not None:  # use the tips of the tool's axes as points
        points = points + np.concatenate(
            [np.zeros((data.size, 1, 3)), data.rotation.swapaxes(1, 2)], axis=1
        )
    M, offsets = _linear(flange, points, base=base, tool=tool)
    turn = _nearest_rotation(M).T
    rotation = np.eye(3)
    if data.rotation is not None:
        rotation = _nearest_rotation((offsets[1:] - offsets[0]).T)
        offsets = offsets[:1]
    reached = flange.origin[:, None] + offsets @ flange.rotation.swapaxes(1, 2)
    shift = np.zeros(3)
    if base:
        shift = np.nanmean(data.position - reached @ turn.T, axis=(0, 1))
    tools = tuple(FixedStep(rotation, offset) for offset in offsets)
    return FixedStep(turn, shift), tools, np.zeros((0, 3))


def _linear(
    flange: Frame, points: Array, *, base: bool, tool: bool
) -> tuple[Array, Array]:
    """Solve M p + u − R x = t for M, u and the offset x of each point.

    A known base has M = 1 and u = 0. A known tool has its tips on the flange's axes.
    """
    count = points.shape[1]
    tips = np.eye(4, 3, -1)[:count]
    solution = np.concatenate([np.eye(3).ravel(), np.zeros(3), tips.ravel()])
    free = np.repeat([base, tool], [12, 3 * count])
    p = points - np.nanmean(points, axis=(0, 1)) * base
    shape = (*p.shape[:2], 3, -1)
    entries = np.einsum("ab,njc->njabc", np.eye(3), p).reshape(*p.shape[:2], 3, 9)
    shift = np.broadcast_to(np.eye(3), (*p.shape[:2], 3, 3))
    own = np.einsum("jk,nab->njakb", np.eye(count), -flange.rotation).reshape(shape)
    seen = np.isfinite(p).all(axis=2)
    A = np.concatenate([entries, shift, own], axis=3)[seen].reshape(-1, len(free))
    target = np.broadcast_to(flange.origin[:, None], p.shape)[seen].ravel()
    target = target - A[:, ~free] @ solution[~free]
    if free.any():
        # Directions that these poses hardly determine stay at zero.
        solution[free] = np.linalg.lstsq(A[:, free], target, rcond=1e-3)[0]
    return solution[:9].reshape(3, 3), solution[12:].reshape(count, 3)


def _nearest_rotation(M: Array) -> Array:
    U, _, Vt = np.linalg.svd(M)
    U[:, -1] *= np.linalg.det(U @ Vt)
    rotation: Array = U @ Vt
    return rotation


def _stations(point: Array, distance: Array) -> Array:
    """Trilateration: |p|² − d² = 2 p·s − |s|² is linear in s and |s|²."""
    found = []
    center = point.mean(axis=0)
    p = point - center
    for d in distance.T:
        seen = np.isfinite(d)
        A = np.column_stack([2 * p[seen], -np.ones(seen.sum())])
        rhs = (p[seen] ** 2).sum(axis=1) - d[seen] ** 2
        *at, square = np.linalg.lstsq(A, rhs, rcond=1e-2)[0]
        _, size, directions = np.linalg.svd(p[seen], full_matrices=False)
        if size[-1] < 1e-2 * size[0]:  # points in a plane: the height is in |s|² alone
            at += directions[-1] * np.sqrt(max(square - np.dot(at, at), 0.0))
        found.append(at + center)
    return np.array(found)
