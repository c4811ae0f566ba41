"""Collision detection by the generalised-momentum observer, for any dynamic model.

Source: De Luca et al. 2006, doi 10.1109/IROS.2006.282053; Haddadin et al. 2017,
doi 10.1109/TRO.2017.2723903.
"""

from __future__ import annotations

import numpy as np
from compensation import CONTROL, torque
from compensation_loop import OBSERVER, SETTLE, inertia
from scipy.signal import lfilter

from hybrid import DynamicModel
from hybrid.arrays import Array
from hybrid.plant import Plant

BLOCK, HOUR = 0.5, 3600.0  # s
PUSHES = 2000


def residual(
    model: DynamicModel, q: Array, v: Array, tau: Array, v_ref: Array
) -> Array:
    """The observer's torque from outside, shape (N − 1, n), [N·m].

    It is what ``p' = τ + M' v − C v − g − f`` lacks, with momentum p = M v, through a
    low-pass filter of the observer's gain. Only inverse dynamics is needed. Friction is
    that at the commanded speed: near standstill a measured one has no sure sign.
    """
    step, still = 1.0 / CONTROL, np.zeros_like(q)
    M = inertia(model, q)
    momentum = np.einsum("kij,kj->ki", M, v)
    carried = np.einsum("kij,kj->ki", np.diff(M, axis=0), v[:-1]) / step
    known = tau[:-1] + carried - torque(model, q, v_ref, still)[:-1]
    lacking = np.diff(momentum, axis=0) / step - known
    decay = np.exp(-OBSERVER * step)
    return np.asarray(lfilter([1 - decay], [1, -decay], lacking, axis=0))


def threshold(residuals: list[Array]) -> Array:
    """Size that a joint's residual exceeds once in n hours without collisions, (n,).

    By the tail of maxima over blocks (Gumbel 1958), as no hour was recorded; so the
    arm raises one false alarm an hour.
    """
    length, start = round(BLOCK * CONTROL), round(SETTLE * CONTROL)
    blocks = []
    for r in residuals:
        r = np.abs(r[start:])
        count = len(r) // length
        blocks.append(r[: count * length].reshape(count, length, -1).max(axis=1))
    maxima = np.concatenate(blocks)
    spread = maxima.std(axis=0) * np.sqrt(6.0) / np.pi
    place = maxima.mean(axis=0) - np.euler_gamma * spread
    often = HOUR / BLOCK * maxima.shape[1]
    return np.asarray(place - spread * np.log(-np.log1p(-1.0 / often)))


def smallest_force(plant: Plant, thresholds: Array, rng: np.random.Generator) -> float:
    """Median force of a steady push on the last link that is noticed, [N].

    Over random postures and directions; a push is noticed at the first joint whose
    torque from it exceeds its threshold.
    """
    import mujoco

    mj, n = plant.robot.mujoco_spec().compile(), plant.robot.size
    data, jacobian = mujoco.MjData(mj), np.zeros((3, n))
    forces = []
    for _ in range(PUSHES):
        data.qpos[:] = rng.uniform(plant.robot.q_min, plant.robot.q_max)
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        body = mj.nbody - 1
        mujoco.mj_jac(mj, data, jacobian, None, data.xpos[body], body)
        direction = rng.normal(size=3)
        felt = np.abs(jacobian.T @ direction) / np.linalg.norm(direction)
        forces.append(np.min(thresholds / np.maximum(felt, 1e-9)))
    return float(np.median(forces))
