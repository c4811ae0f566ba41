"""Torque of a model's effects.

Laws that depend on one instant are compiled together, so that common terms are computed
once. Effects that depend on a whole motion are evaluated one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import Law, RigidBody, Tape, inverse_dynamics
from hybrid.effects import Effect, JointState
from hybrid.errors import HybridError
from hybrid.robot.chain import Chain
from hybrid.signals import Motion


@dataclass(frozen=True, eq=False)
class EffectTorque:
    """The effects of an arm, sorted by the way to compute their torque.

    Attributes:
        law: Torque of laws of one instant at every joint, from positions, speeds,
            accelerations and loads; or None.
        links: Change of link parameters that is equivalent to some effects, shape
            (n, 10); or None.
        gravity: Change of gravity that is equivalent to some effects, shape (3,),
            [m/s²]; or None.
        others: Effects that depend on a whole motion.
    """

    law: Law | None
    links: Array | None
    gravity: Array | None
    others: tuple[Effect, ...]

    def __call__(self, motion: Motion, body: RigidBody) -> Array:
        """Torque of all effects, shape (N, n), [N·m]."""
        q, v, a = motion.q, motion.v, motion.a
        tau = body.load
        tau = self.law.along((q, v, a, tau)) if self.law else np.zeros_like(tau)
        if self.links is not None:
            tau += inverse_dynamics(body.chain, self.links, q, v, a)
        if self.gravity is not None:
            tau += body.weight(self.gravity)
        for effect in self.others:
            tau[:, effect.reaches(tau.shape[1])] += effect.torque(motion, body)
        return tau


def effect_torque(chain: Chain, effects: Sequence[Effect]) -> EffectTorque:
    """Sort the effects of an arm, and compile their laws."""
    n, tape = chain.size, Tape()
    names = tuple(f"{x}[{j}]" for x in ("q", "v", "a", "load") for j in range(n))
    given = [tape.input(name) for name in names]
    q, v, a, load = (given[k * n : k * n + n] for k in range(4))
    t = tape.input("t")
    states = [JointState(t, q[j], v[j], a[j], np.sign(v[j]), load[j]) for j in range(n)]
    torque: list[Any] = [0.0] * n
    links, gravity = np.zeros((n, 10)), np.zeros(3)
    others = []
    for effect in effects:
        change = effect.rigid_change(n, chain.gravity)
        if change is not None:
            links, gravity = links + change[0], gravity + change[1]
            continue
        law = _compiled(effect, states, tape)
        if law is None:
            others.append(effect)
        else:
            for j, x in law.items():
                torque[j] = torque[j] + x
    some = any(not isinstance(x, float) or x != 0.0 for x in torque)
    return EffectTorque(
        law=Law(tape, tuple(torque), names) if some else None,
        links=links if links.any() else None,
        gravity=gravity if gravity.any() else None,
        others=tuple(others),
    )


def _compiled(
    effect: Effect, states: Sequence[JointState], tape: Tape
) -> Mapping[int, Any] | None:
    """Torque of a law of one instant, by joint; None if it is no such law."""
    if effect.changes_signals or effect.asks or effect.memory or effect.not_in_loop:
        return None
    try:
        values, _ = effect.at_instant([states[j] for j in effect.joints], (), 0.0)
    except (HybridError, TypeError, ValueError):  # it cannot be compiled
        return None
    used = {tape.lines[k].arguments[0] for k in tape.needed(values)}
    return None if "t" in used else dict(zip(effect.joints, values, strict=True))
