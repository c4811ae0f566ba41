"""Torque of a model's effects; laws of one instant are evaluated together.

Laws of one instant are written down once for a model, so that what is common to them is
worked out once. Effects that look at a whole motion are asked one by one.
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
    """The effects of an arm, sorted by how their torque is found.

    Attributes:
        law: Torque of the laws of one instant at every joint, from positions, speeds,
            accelerations and loads; None if there is none.
        links: Change of link parameters that has the torque of some, shape (n, 10);
            None if there is none.
        gravity: Change of gravity that has the torque of some, shape (3,), [m/s²]; None
            if there is none.
        others: Effects that look at a whole motion.
    """

    law: Law | None
    links: Array | None
    gravity: Array | None
    others: tuple[Effect, ...]

    def __call__(self, motion: Motion, body: RigidBody) -> Array:
        """Torque of all effects, shape (N, n), [N·m].

        Args:
            motion: N samples of the arm's motion.
            body: Its rigid body along them.
        """
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
    """Sort the effects of an arm, and write their laws down."""
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
        law = _written(effect, states, tape)
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


def _written(
    effect: Effect, states: Sequence[JointState], tape: Tape
) -> Mapping[int, Any] | None:
    """Torque at the joints of a law of one instant; None if it is none."""
    if effect.observes or effect.reports or effect.asks or effect.memory:
        return None
    if effect.not_in_loop:
        return None
    try:
        values, _ = effect.at_instant([states[j] for j in effect.joints], (), 0.0)
    except (HybridError, TypeError, ValueError):  # it has no such form: take it as is
        return None
    used = {tape.lines[k].arguments[0] for k in tape.needed(values)}
    return None if "t" in used else dict(zip(effect.joints, values, strict=True))
