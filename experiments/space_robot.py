"""A free-floating robot reduced to two joints, without gravity, with shared friction.

Regressor of the reduced dynamics (Slotine and Li 1987, doi 10.1177/027836498700600303)
in α, β, ε, η, and motion under desired torques. Nothing here prints.

The printed argument of the desired torques is ambiguous. Here they are 5 sin and 5 cos
of 3·2πk/55 N·m, samples 0.1 s apart; they move the arm, the drives add the friction.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from hybrid.arrays import Array

NAMES = ("α", "β", "ε", "η", "f_c", "f_s", "v_s", "f_v")
TRUE = np.array([1 / 12 + 1 / 4 + 3 + 2 / 5 + 3, 3.4, 3.0, 0.0, 2.8, 3.4, 0.1, 0.2])
LOWER = np.array([0, 0, 0, 0, 0, 0, 0.01, 0])
UPPER = np.array([10, 10, 10, 1, 5, 5, 1, 1.0])
STEP, SAMPLES, OFFLINE = 0.1, 55, 21  # s; 34 recursions follow


def rigid_columns(q: Array, v: Array, a: Array) -> Array:
    """Torque per unit of α, β, ε, η; states (N, 2), columns (N, 2, 4)."""
    s, c, zero = np.sin(q[:, 1]), np.cos(q[:, 1]), np.zeros(len(q))
    (v1, v2), (a1, a2) = v.T, a.T
    turn = 2 * v1 * v2 + v2**2
    first = [a1, a2, c * (2 * a1 + a2) - s * turn, s * (2 * a1 + a2) + c * turn]
    second = [zero, a1 + a2, c * a1 + s * v1**2, s * a1 - c * v1**2]
    return np.stack([np.stack(first, -1), np.stack(second, -1)], axis=1)


def motion() -> tuple[Array, Array, Array, Array]:
    """Position, speed, acceleration and measured torque, shape (55, 2), no noise."""

    def desired(t: Array | float) -> Array:
        angle = 6 * np.pi * np.asarray(t) / (STEP * SAMPLES)
        return 5 * np.stack([np.sin(angle), np.cos(angle)], axis=-1)

    def acceleration(q: Array, v: Array, tau: Array) -> Array:
        unit = np.stack(
            [rigid_columns(q, 0 * v, np.tile(e, (len(q), 1))) for e in np.eye(2)], 1
        )
        mass = (unit @ TRUE[:4]).transpose(0, 2, 1)
        bias = rigid_columns(q, v, 0 * v) @ TRUE[:4]
        return np.asarray(np.linalg.solve(mass, (tau - bias)[..., None])[..., 0])

    def flow(t: float, x: Array) -> Array:
        return np.append(
            x[2:], acceleration(x[None, :2], x[None, 2:], desired(t)[None])
        )

    t = STEP * np.arange(SAMPLES)
    path = solve_ivp(flow, (0, t[-1]), [0, 0.5, 0, 0], t_eval=t, rtol=1e-10, atol=1e-12)
    q, v = path.y[:2].T, path.y[2:].T
    a = acceleration(q, v, desired(t))
    return q, v, a, predicted(TRUE[None], q, v, a)[0]


def predicted(p: Array, q: Array, v: Array, a: Array) -> Array:
    """Torque (P, N, 2) of parameter vectors (P, 8)."""
    f_c, f_s, v_s, f_v = p.T[4:, :, None, None]
    level = f_c + (f_s - f_c) * np.exp(-((v / v_s) ** 2))
    rigid = np.einsum("nik,pk->pni", rigid_columns(q, v, a), p[:, :4])
    return np.asarray(rigid + level * np.sign(v) + f_v * v)
