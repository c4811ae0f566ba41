"""Recursive Newton–Euler algorithm for scalars: numbers or symbols.

Source: Luh, Walker and Paul 1980, doi 10.1115/1.3149599; with parameters about the
frame origin as in Atkeson et al. 1986, doi 10.1177/027836498600500306.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.chain import Chain
from hybrid.robot.spatial import INERTIA, skew

Vector = Any  # array of three scalars; NumPy computes with them as objects
_ROUNDING = 1e-15  # entry of a rotation that counts as zero


class _Link(NamedTuple):
    """Placement of a frame in its parent, and the link's motion in its own frame."""

    turn: Any  # shape (3, 3)
    arm: Vector
    axis: Vector
    omega: Vector
    alpha: Vector
    accel: Vector  # of the frame origin less gravity


def newton_euler(
    chain: Chain,
    inertial: Sequence[Sequence[Any]],
    gravity: Sequence[Any] | Array,
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
    force = moment = _scalars(np.zeros(3))
    torque: list[Any] = []
    for k in reversed(range(chain.size)):
        link = links[k]
        own_force, own_moment = _wrench(_scalars(inertial[k]), link)
        force, moment = force + own_force, moment + own_moment
        torque.append(link.axis @ (moment if chain.revolute[k] else force))
        force = link.turn @ force
        moment = link.turn @ moment + _cross(link.arm, force)
    return torque[::-1]


def unit_torques(
    chain: Chain, *, q: Sequence[Any], v: Sequence[Any], a: Sequence[Any]
) -> Any:
    """Torque of each joint per unit of each inertial parameter, shape (n, 10n).

    The arguments are those of :func:`newton_euler`.
    """
    torque = _scalars(np.zeros((chain.size, 10 * chain.size)))
    screws: list[tuple[Vector, Vector]] = []  # turn and shift of the link by each joint
    for k, link in enumerate(_links(chain, chain.gravity, q, v, a)):
        back = link.turn.T
        screws = [(back @ u, back @ (s + _cross(u, link.arm))) for u, s in screws]
        still = _scalars(np.zeros(3))
        screws.append((link.axis, still) if chain.revolute[k] else (still, link.axis))
        wrenches = [_wrench(unit, link) for unit in _scalars(np.eye(10))]
        for j, (u, s) in enumerate(screws):
            own = [s @ force + u @ moment for force, moment in wrenches]
            torque[j, 10 * k : 10 * k + 10] = own
    return torque


def _links(
    chain: Chain,
    gravity: Sequence[Any] | Array,
    q: Sequence[Any],
    v: Sequence[Any],
    a: Sequence[Any],
) -> Iterator[_Link]:
    """Links, base to tip."""
    omega = alpha = _scalars(np.zeros(3))
    accel = -_scalars(gravity)
    speeds, rates = _scalars([v, a])[..., None]  # in rows of one, times a vector
    for k, (speed, rate) in enumerate(zip(speeds, rates, strict=True)):
        turn, arm = _placement(chain, k, q[k])
        axis = _scalars(chain.axis[k])
        accel = accel + _cross(alpha, arm) + _cross(omega, _cross(omega, arm))
        omega, alpha, accel = turn.T @ omega, turn.T @ alpha, turn.T @ accel
        spin = _cross(omega, axis)
        if chain.revolute[k]:
            alpha = alpha + speed * spin + rate * axis
            omega = omega + speed * axis
        else:
            accel = accel + 2.0 * speed * spin + rate * axis
        yield _Link(turn, arm, axis, omega, alpha, accel)


def _placement(chain: Chain, k: int, q: Any) -> tuple[Any, Vector]:
    """Rotation and offset of frame k in its parent."""
    fixed, offset = chain.rotation[k], chain.translation[k]
    if not chain.revolute[k]:
        line = np.stack([offset, _without_rounding(fixed @ chain.axis[k])], axis=-1)
        return _without_rounding(fixed), line @ _scalars([1.0, q])
    cross = skew(chain.axis[k])
    terms = fixed @ (np.eye(3) + cross @ cross), fixed @ cross, fixed @ (-cross @ cross)
    turn = np.stack([_without_rounding(x) for x in terms], axis=-1)
    return turn @ _scalars([1.0, np.sin(q), np.cos(q)]), _scalars(offset)


def _without_rounding(x: Array) -> Array:
    """Numbers in which rounding errors of the file's angles are zero."""
    return np.where(np.abs(x) < _ROUNDING, 0.0, x)


def _wrench(inertial: Any, link: _Link) -> tuple[Vector, Vector]:
    """Force and moment about the frame origin that accelerate a link."""
    m, mc, inertia = inertial[:1], inertial[1:4], inertial[INERTIA]
    omega, alpha, accel = link.omega, link.alpha, link.accel
    force = m * accel + _cross(alpha, mc) + _cross(omega, _cross(omega, mc))
    moment = inertia @ alpha + _cross(omega, inertia @ omega) + _cross(mc, accel)
    return force, moment


def _scalars(values: Any) -> Any:
    return np.array(values, dtype=object)


def _cross(x: Vector, y: Vector) -> Vector:
    return _scalars(
        [
            x[1] * y[2] - x[2] * y[1],
            x[2] * y[0] - x[0] * y[2],
            x[0] * y[1] - x[1] * y[0],
        ]
    )
