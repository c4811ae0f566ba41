"""Batched inverse dynamics, its regressor tau = Y(q, v, a) · pi, and their gradients.

The recursive Newton–Euler algorithm runs once for each arm, on symbols. The operations
that it records are compiled to functions of arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.dynamics.law import Law
from hybrid.dynamics.newton_euler import newton_euler, unit_torques
from hybrid.dynamics.tape import Symbol, Tape
from hybrid.robot.chain import Chain

_MOST_ARMS = 64  # in each cache


def inverse_dynamics(
    chain: Chain, inertial: Array, q: Array, v: Array, a: Array
) -> Array:
    """Rigid-body joint torque, without rotor inertia.

    Args:
        chain: The arm.
        inertial: Link parameters, shape (n, 10).
        q: Positions, shape (N, n), [rad].
        v: Speeds, shape (N, n), [rad/s].
        a: Accelerations, shape (N, n), [rad/s²].

    Returns:
        Torque, shape (N, n), [N·m].
    """
    constants = [*inertial.ravel().tolist(), *chain.gravity.tolist()]
    return _torque_law(_arm(chain)).along((q, v, a), constants)


def regressor(chain: Chain, q: Array, v: Array, a: Array) -> Array:
    """Torque per unit of each inertial parameter along a motion.

    The motion is that of :func:`inverse_dynamics`.

    Returns:
        Y, shape (N, n, 10n), link by link in the order of ``INERTIAL_NAMES``. It is a
        view of an array of shape (n, 10n, N).
    """
    n = chain.size
    rows = regressor_law(chain, tuple(range(10 * n * n))).rows((q, v, a))
    return rows.reshape(n, 10 * n, len(q)).transpose(2, 0, 1)


def regressor_law(chain: Chain, entries: tuple[int, ...]) -> Law:
    """Entries of the flattened (n, 10n) regressor; inputs are q, v and a; cached."""
    return _regressor_law(_arm(chain, chain.gravity), entries)


def regressor_gradient(
    chain: Chain, q: Array, v: Array, a: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Derivatives of ``sum(weight * regressor(chain, q, v, a))`` by the motion.

    The weight of each entry of the regressor has shape (N, n, 10n); entries of joints
    beyond a link have no effect.

    Returns:
        Derivatives by q, v and a, each of shape (N, n).
    """
    law, entries = _gradient_law(_arm(chain, chain.gravity))
    weights = weight.reshape(len(q), 10 * chain.size**2)[:, entries]
    found = law.along((q, v, a, weights))
    by_q, by_v, by_a = np.split(found, 3, axis=1)
    return by_q, by_v, by_a


def torque_gradient(
    chain: Chain, q: Array, v: Array, a: Array, inertial: Array, joint: Index
) -> tuple[Array, Array, Array]:
    """Derivatives of one joint's rigid-body torque in each sample by the motion.

    ``joint`` is the index of the joint in each sample, shape (N,); the other arguments
    are those of :func:`inverse_dynamics`.

    Returns:
        Derivatives by q, v and a, each of shape (N, n).
    """
    weight = np.zeros((*q.shape, inertial.size))
    weight[np.arange(len(q)), joint] = inertial.ravel()
    return regressor_gradient(chain, q, v, a, weight)


@dataclass(frozen=True)
class _Arm:
    """A chain as a key of caches, equal for equal content."""

    content: bytes
    chain: Chain = field(compare=False)


def _arm(chain: Chain, *more: Array) -> _Arm:
    """A chain that is equal for equal kinematics, and equal further arrays."""
    arrays = chain.rotation, chain.translation, chain.axis, chain.revolute, *more
    return _Arm(b"".join(x.tobytes() for x in arrays), chain)


@lru_cache(maxsize=_MOST_ARMS)
def _torque_law(arm: _Arm) -> Law:
    """Torque from q, v and a, then ten parameters of each link, then gravity."""
    tape, n = Tape(), arm.chain.size
    names = [*_motion_names(n), *(f"link[{i}]" for i in range(10 * n))]
    names += [f"gravity[{c}]" for c in range(3)]
    given = _inputs(tape, names)
    q, v, a = given[: 3 * n].reshape(3, n)
    links, gravity = given[3 * n : -3].reshape(n, 10), given[-3:]
    torque = newton_euler(arm.chain, links, gravity, q=q, v=v, a=a)
    return Law(tape, tuple(torque), tuple(names))


@lru_cache(maxsize=_MOST_ARMS)
def _regressor_tape(arm: _Arm) -> tuple[Tape, list[str], list[Any]]:
    """Tape, names of its inputs, and the n · 10n entries of the regressor."""
    tape, names = Tape(), _motion_names(arm.chain.size)
    q, v, a = _inputs(tape, names).reshape(3, -1)
    torque = unit_torques(arm.chain, q=q, v=v, a=a)
    return tape, names, torque.ravel().tolist()


@lru_cache(maxsize=_MOST_ARMS)
def _regressor_law(arm: _Arm, entries: tuple[int, ...]) -> Law:
    tape, names, every = _regressor_tape(arm)
    return Law(tape, tuple(every[k] for k in entries), tuple(names))


@lru_cache(maxsize=_MOST_ARMS)
def _gradient_law(arm: _Arm) -> tuple[Law, list[int]]:
    """Gradient from q, v, a and weights of some entries, and these entries."""
    tape, names, every = _regressor_tape(arm)
    entries = [k for k, x in enumerate(every) if isinstance(x, Symbol)]
    weights = [f"weight[{k}]" for k in entries]
    seeds, motion = _inputs(tape, weights), _inputs(tape, names)
    found = tape.gradient([every[k] for k in entries], seeds, motion)
    return Law(tape, tuple(found), (*names, *weights)), entries


def _motion_names(n: int) -> list[str]:
    return [f"{x}[{j}]" for x in "qva" for j in range(n)]


def _inputs(tape: Tape, names: Sequence[str]) -> Any:
    return np.array([tape.input(name) for name in names], dtype=object)
