"""The arm under control: tracking, guiding by hand, what a collision must exceed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from compensation import CONTROL, FREQUENCY, SETTLE, torque

from hybrid import DynamicModel
from hybrid.arrays import Array
from hybrid.plant import Plant, Reference
from hybrid.plant.lockstep import Lockstep

OMEGA = 2 * np.pi * FREQUENCY
OBSERVER = 25.0  # 1/s, gain of the momentum observer
STILL = 0.03  # rad/s, below which friction is not compensated under a hand
HAND, DAMPED = 3.0, 0.3  # of the rated torque per rad and per rad/s


def inertia(model: DynamicModel, q: Array) -> Array:
    """Joint-space inertia at positions, shape (N, n, n), [kg·m²]."""
    still, columns = np.zeros_like(q), []
    rest = torque(model, q, still, still)
    for unit in np.eye(q.shape[1]):
        columns.append(torque(model, q, still, still + unit) - rest)
    return np.stack(columns, axis=2)


def track(
    plant: Plant, models: Sequence[DynamicModel], references: Sequence[Reference]
) -> dict[str, Array]:
    """Follow references with each model's computed torque, shape (N, models·refs, n).

    ``τ = τ̂(q_ref, v_ref, a_ref) + M̂(q_ref) [ω² (q_ref − q) + 2ω (v_ref − v)]``, all
    models and references in lockstep; the log has q, v and tau, and the reference.
    """
    plans = []
    for model in models:
        for ref in references:
            feed = torque(model, ref.q, ref.v, ref.a)
            plans.append((ref.q, ref.v, feed, inertia(model, ref.q)))
    q_ref, v_ref, feed, M = (np.stack(x, axis=1) for x in zip(*plans, strict=True))
    limit, substeps = plant.robot.tau_max, round(1 / (plant.step * CONTROL))
    state = Lockstep(plant.arm, plant.effects, q_ref[0])
    wait = round(SETTLE * CONTROL)
    log = {x: np.empty_like(q_ref) for x in ("q", "v", "tau")}
    for k in range(-wait, len(q_ref)):
        at, moving = max(k, 0), float(k >= 0)
        pull = OMEGA**2 * (q_ref[at] - state.q)
        pull += 2 * OMEGA * (moving * v_ref[at] - state.v)
        tau = feed[at] + np.einsum("bij,bj->bi", M[at], pull)
        tau = np.clip(tau, -limit, limit)
        if k >= 0:
            log["q"][k], log["v"][k], log["tau"][k] = state.q, state.v, tau
        state.step(tau, substeps)
    return log | {"q_ref": q_ref, "v_ref": v_ref}


def guide(
    plant: Plant,
    models: Sequence[Callable[[Array, Array, Array], Array]],
    reference: Reference,
) -> Array:
    """RMS torque of a hand that leads the arm along a motion, shape (models, n), [N·m].

    The drives hold the weight and give back the friction of each model; below a small
    speed less of it, so that nothing moves by itself. The hand is a spring and damper.
    """
    n, rated = plant.robot.size, plant.robot.tau_max
    state = Lockstep(
        plant.arm, plant.effects, np.tile(reference.q[0], (len(models), 1))
    )
    substeps, still = round(1 / (plant.step * CONTROL)), np.zeros((1, n))
    squares = np.zeros((len(models), n))
    for q_hand, v_hand in zip(reference.q, reference.v, strict=True):
        hand = HAND * rated * (q_hand - state.q) + DAMPED * rated * (v_hand - state.v)
        drive = np.empty_like(hand)
        for b, model in enumerate(models):
            q, v = state.q[b : b + 1], state.v[b : b + 1]
            weight = model(q, still, still)
            share = np.minimum(1.0, (v / STILL) ** 2)
            drive[b] = (weight + share * (model(q, v, still) - weight))[0]
        squares += hand**2
        state.step(np.clip(drive, -rated, rated) + hand, substeps)
    return np.sqrt(squares / len(reference.q))
