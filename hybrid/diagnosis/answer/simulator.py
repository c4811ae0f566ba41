"""Add the findings of a diagnosis to the simulator: a physical arm, and effects."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import delivered, with_gains
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.explanations.physical import is_physical, nearest_physical
from hybrid.dynamics import inverse_dynamics
from hybrid.effects import Effect
from hybrid.plant.joint_fields import declared_effects
from hybrid.robot import Robot

_NUMBERS = "damping", "frictionloss", "quadratic", "cubic", "stiffness"  # of a file
# An elasticity or a backlash needs a rotor. If the file declares none, this share of
# the inertia that the joint moves is assumed.
_ROTOR = 0.02


def scored_effects(scored: Explanation) -> tuple[Effect, ...]:
    """The terms of an explanation as effects, with the gains that were scored."""
    gains = scored.gains[len(scored.rigid) :]
    edges = np.cumsum([len(own) for own in scored.own])[:-1]
    parts = np.split(gains, edges) if scored.own else []
    pairs = zip(scored.terms, parts, strict=True)
    return delivered(
        [with_gains(t.candidate.effect, x).as_reported() for t, x in pairs]
    )


def corrected(
    scored: Explanation, effects: Sequence[Effect], background: Array | None = None
) -> tuple[Robot, tuple[Effect, ...]]:
    """Correct the numbers of the simulator, and add some effects.

    Rotor inertia and payloads become part of the arm; the other effects are returned
    besides. Links that are not physical are replaced by the physical ones that change
    the torque of the motions least. The errors of links and declared numbers are the
    ``background``, shape (b,); those that were scored by default.
    """
    robot = scored.gap.robot
    errors = scored.gains[: len(scored.rigid)] if background is None else background
    links, rest = np.split(errors, [10 * robot.size])
    chain, inertial = robot.chain, robot.chain.inertial + links.reshape(-1, 10)
    armature, others = chain.armature.copy(), []
    numbers = {name: getattr(robot, name).copy() for name in _NUMBERS}
    known = numbers | {"armature": armature}
    for effect, error in zip(declared_effects(robot), rest, strict=False):
        for field in known.keys() & effect.fields.values():
            known[field][list(effect.joints)] *= max(1.0 + error, 0.0)
    for effect in effects:
        change = effect.rigid_change(robot.size, chain.gravity)
        if change is not None and not change[1].any():
            inertial += change[0]
        elif set(effect.fields.values()) == {"armature"}:
            armature[effect.joints[0]] += effect.gain_values.sum()
        else:
            others.append(effect)
    for effect in others:
        j = effect.joints[0]
        if effect.behind and armature[j] <= 0:
            armature[j] = _ROTOR * _mean_inertia(scored, j)
    links, rotors = _physical(scored, inertial), np.maximum(armature, 0.0)
    chain = replace(chain, inertial=links, armature=rotors)
    return replace(robot, chain=chain, **numbers), tuple(others)


def _mean_inertia(scored: Explanation, joint: int) -> float:
    """Mean inertia about a joint along the motions, [kg·m²]."""
    q = scored.gap.sampled.q
    still, unit = np.zeros_like(q), np.zeros_like(q)
    unit[:, joint] = 1.0
    chain = replace(scored.gap.robot.chain, gravity=np.zeros(3))
    torque = inverse_dynamics(chain, chain.inertial, q, still, unit)
    return float(np.mean(torque[:, joint]))


def _physical(scored: Explanation, inertial: Array) -> Array:
    """The physical links that are nearest to given links, in the metric of torque."""
    if is_physical(inertial):  # as with all effects together
        return inertial
    columns = scored.index[: inertial.size]
    A, _ = scored.evidence.normal(columns)
    metric = A + np.diag(scored.evidence.precision[columns])
    return nearest_physical(inertial, metric, scored.gap.robot.chain)
