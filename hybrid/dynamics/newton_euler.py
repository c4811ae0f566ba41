"""Recursive Newton–Euler algorithm for scalars: numbers, arrays or symbols.

Source: Luh, Walker and Paul 1980, doi 10.1115/1.3149599; with parameters about the
frame origin as in Atkeson et al. 1986, doi 10.1177/027836498600500306.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.chain import Chain
from hybrid.robot.spatial import skew

Vector = list[Any]
_ROUNDING = 1e-15  # entry of a rotation that counts as zero


class _Link(NamedTuple):
    """Placement of a frame in its parent, and the link's motion in its own frame."""

    turn: list[Vector]
    arm: Vector
    axis: Vector
    omega: Vector
    alpha: Vector
    accel: Vector  # of the frame origin less gravity


def newton_euler(
    chain: Chain,
    inertial: Sequence[Sequence[Any]],
    gravity: Sequence[Any],
    *,
    q: Sequence[Any],
    v: Sequence[Any],
    a: Sequence[Any],
) -> list[Any]:
    """Rigid-body joint torque, length n, [N·m].

    Of the chain only the kinematics are used. Each link has ten inertial parameters;
    gravity is in the base frame, [m/s²]. Positions q [rad], speeds v and accelerations
    a have length n.
    """
    links = list(_links(chain, gravity, q, v, a))
    force, moment = [0.0] * 3, [0.0] * 3
    torque: list[Any] = []
    for k in reversed(range(chain.size)):
        link = links[k]
        own_force, own_moment = _wrench(inertial[k], link)
        force, moment = _add(force, own_force), _add(moment, own_moment)
        torque.append(_dot(link.axis, moment if chain.revolute[k] else force))
        force = _turned(link.turn, force)
        moment = _add(_turned(link.turn, moment), _cross(link.arm, force))
    return torque[::-1]


def unit_torques(
    chain: Chain, *, q: Sequence[Any], v: Sequence[Any], a: Sequence[Any]
) -> list[list[Any]]:
    """Torque of each joint per unit of each inertial parameter, n lists of 10n.

    The arguments are those of :func:`newton_euler`.
    """
    rows: list[list[Any]] = [[] for _ in range(chain.size)]
    screws: list[tuple[Vector, Vector]] = []  # turn and shift of the link by each joint
    for k, link in enumerate(_links(chain, chain.gravity.tolist(), q, v, a)):
        screws = [
            (_turned_back(link.turn, u), _turned_back(link.turn, _add(s, w)))
            for u, s in screws
            for w in [_cross(u, link.arm)]
        ]
        still = [0.0] * 3
        screws.append((link.axis, still) if chain.revolute[k] else (still, link.axis))
        wrenches = [_wrench(unit, link) for unit in np.eye(10).tolist()]
        for row, (u, s) in zip(rows, screws, strict=False):
            row += [_dot(s, force) + _dot(u, moment) for force, moment in wrenches]
        for row in rows[k + 1 :]:
            row += [0.0] * 10
    return rows


def _links(
    chain: Chain,
    gravity: Sequence[Any],
    q: Sequence[Any],
    v: Sequence[Any],
    a: Sequence[Any],
) -> Iterator[_Link]:
    """Links, base to tip."""
    omega, alpha, accel = [0.0] * 3, [0.0] * 3, [-g for g in gravity]
    for k in range(chain.size):
        turn, arm = _placement(chain, k, q[k])
        axis = [float(x) for x in chain.axis[k]]
        accel = _add(accel, _cross(alpha, arm), _cross(omega, _cross(omega, arm)))
        omega, alpha, accel = (_turned_back(turn, x) for x in (omega, alpha, accel))
        spin = _cross(omega, axis)
        if chain.revolute[k]:
            alpha = _add(alpha, _times(spin, v[k]), _times(axis, a[k]))
            omega = _add(omega, _times(axis, v[k]))
        else:
            accel = _add(accel, _times(spin, 2.0 * v[k]), _times(axis, a[k]))
        yield _Link(turn, arm, axis, omega, alpha, accel)


def _placement(chain: Chain, k: int, q: Any) -> tuple[list[Vector], Vector]:
    """Rotation and offset of frame k in its parent."""
    fixed, offset = chain.rotation[k], chain.translation[k].tolist()
    if not chain.revolute[k]:
        direction = _without_rounding(fixed @ chain.axis[k])
        moved = [o + d * q for o, d in zip(offset, direction, strict=True)]
        return _without_rounding(fixed), moved
    cross = skew(chain.axis[k])
    terms = fixed @ (np.eye(3) + cross @ cross), fixed @ cross, fixed @ (-cross @ cross)
    constant, sine, cosine = map(_without_rounding, terms)
    sin_q, cos_q = np.sin(q), np.cos(q)
    turn = [
        [constant[r][c] + sine[r][c] * sin_q + cosine[r][c] * cos_q for c in range(3)]
        for r in range(3)
    ]
    return turn, offset


def _without_rounding(x: Array) -> list[Any]:
    """Numbers in which rounding errors of the file's angles are zero."""
    found: list[Any] = np.where(np.abs(x) < _ROUNDING, 0.0, x).tolist()
    return found


def _wrench(inertial: Sequence[Any], link: _Link) -> tuple[Vector, Vector]:
    """Force and moment about the frame origin that accelerate a link."""
    m, *rest = inertial
    mc, (xx, xy, yy, xz, yz, zz) = rest[:3], rest[3:]
    inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    omega, alpha, accel = link.omega, link.alpha, link.accel
    force = _add(_times(accel, m), _cross(alpha, mc), _cross(omega, _cross(omega, mc)))
    moment = _add(
        _turned(inertia, alpha),
        _cross(omega, _turned(inertia, omega)),
        _cross(mc, accel),
    )
    return force, moment


def _add(*vectors: Vector) -> Vector:
    return [sum(x[1:], x[0]) for x in zip(*vectors, strict=True)]


def _times(x: Vector, factor: Any) -> Vector:
    return [factor * c for c in x]


def _dot(x: Vector, y: Vector) -> Any:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _cross(x: Vector, y: Vector) -> Vector:
    return [
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    ]


def _turned(matrix: list[Vector], x: Vector) -> Vector:
    return [_dot(row, x) for row in matrix]


def _turned_back(matrix: list[Vector], x: Vector) -> Vector:
    return [_dot(list(column), x) for column in zip(*matrix, strict=True)]
