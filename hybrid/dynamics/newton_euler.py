"""Recursive Newton–Euler algorithm for scalars: numbers, arrays or symbols.

Source: Luh, Walker and Paul 1980, doi 10.1115/1.3149599; with parameters about the
frame origin as in Atkeson et al. 1986, doi 10.1177/027836498600500306.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from hybrid.dynamics.kinematics import rotation_terms, without_rounding
from hybrid.dynamics.law import Law
from hybrid.dynamics.tape import Tape
from hybrid.robot.chain import INERTIAL_NAMES, Chain

Vector = list[Any]
_MOST_ARMS = 64  # in the cache of laws


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

    Args:
        chain: The arm; only its kinematics are used.
        inertial: Ten parameters of each link, length n.
        gravity: Acceleration of gravity in the base frame, length 3, [m/s²].
        q: Position of each joint, length n, [rad].
        v: Speed of each joint, length n, [rad/s].
        a: Acceleration of each joint, length n, [rad/s²].
    """
    omega, alpha, accel = [0.0] * 3, [0.0] * 3, [-g for g in gravity]
    frames, wrenches = [], []
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
        frames.append((turn, arm, axis))
        wrenches.append(_wrench(inertial[k], omega, alpha, accel))
    force, moment = [0.0] * 3, [0.0] * 3
    torque: list[Any] = []
    for k in reversed(range(chain.size)):
        turn, arm, axis = frames[k]
        force, moment = _add(force, wrenches[k][0]), _add(moment, wrenches[k][1])
        torque.append(_dot(axis, moment if chain.revolute[k] else force))
        force = _turned(turn, force)
        moment = _add(_turned(turn, moment), _cross(arm, force))
    return torque[::-1]


def rigid_law(chain: Chain) -> Law:
    """Torque of an arm's joints as a compiled function; cached.

    Its inputs are positions, speeds and accelerations, then ten parameters of each
    link, then gravity.
    """
    return _compiled(_Kinematics(chain))


class _Kinematics:
    """The constants of a chain's kinematics, as a key of the cache."""

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        arrays = (chain.rotation, chain.translation, chain.axis, chain.revolute)
        self.content = b"".join(x.tobytes() for x in arrays)

    def __hash__(self) -> int:
        return hash(self.content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kinematics) and self.content == other.content


@lru_cache(maxsize=_MOST_ARMS)
def _compiled(arm: _Kinematics) -> Law:
    tape, n = Tape(), arm.chain.size
    names = [f"{x}[{j}]" for x in "qva" for j in range(n)]
    names += [f"{x}_{k + 1}" for k in range(n) for x in INERTIAL_NAMES]
    names += [f"gravity[{c}]" for c in range(3)]
    given = [tape.input(name) for name in names]
    q, v, a = (given[k * n : k * n + n] for k in range(3))
    links = [given[3 * n + 10 * k : 3 * n + 10 * k + 10] for k in range(n)]
    torque = newton_euler(arm.chain, links, given[-3:], q=q, v=v, a=a)
    return Law(tape, tuple(torque), tuple(names))


def _placement(chain: Chain, k: int, q: Any) -> tuple[list[Vector], Vector]:
    """Rotation and offset of frame k in its parent."""
    offset = chain.translation[k]
    constant, sine, cosine = (x.tolist() for x in rotation_terms(chain, k))
    if not chain.revolute[k]:
        direction = without_rounding(chain.rotation[k] @ chain.axis[k]).tolist()
        return constant, [o + d * q for o, d in zip(offset, direction, strict=True)]
    sin_q, cos_q = np.sin(q), np.cos(q)
    turn = [
        [constant[r][c] + sine[r][c] * sin_q + cosine[r][c] * cos_q for c in range(3)]
        for r in range(3)
    ]
    return turn, [float(x) for x in offset]


def _wrench(
    inertial: Sequence[Any], omega: Vector, alpha: Vector, accel: Vector
) -> tuple[Vector, Vector]:
    """Force and moment about the frame origin that accelerate a link."""
    m, *rest = inertial
    mc, (xx, xy, yy, xz, yz, zz) = rest[:3], rest[3:]
    inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
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
