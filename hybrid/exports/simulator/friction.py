"""A friction curve that a simulator has no field for, as the nearest that it has.

Friction is fitted as frictionloss·sgn v + damping·v + quadratic·v|v| + cubic·v³, and
two levels of dry friction where a joint may have a preload, over the speeds of
motions. It is a sum of parts that each take energy at every speed, none below zero:
v(1 − |v|/w)² for some w is what makes the sum bend downwards.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.instant import FRICTION
from hybrid.signals import Motion

_BENDS = np.geomspace(0.25, 4.0, 9)  # w, of the highest speed


@dataclass(frozen=True)
class StandIn:
    """What stands in for the friction of a joint.

    Attributes:
        joint: The joint, counted from 0.
        effects: Effects of which the friction is the sum, beside exact ones.
        values: ``frictionloss``, ``damping``, ``quadratic``, ``cubic``, and
            ``preload``, SI units.
        missed: RMS of the torque that is left, [N·m].
        torque: RMS of the friction itself, [N·m].
    """

    joint: int
    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    missed: float
    torque: float


def is_friction(effect: Effect) -> bool:
    """Whether an effect is a friction of one joint."""
    return len(effect.joints) == 1 and any(
        field in FRICTION for field in effect.fields.values()
    )


def stand_in(
    effects: Sequence[Effect],
    exact: Mapping[str, float],
    moved: Sequence[tuple[Motion, RigidBody]],
    fields: Collection[str],
) -> StandIn:
    """Fit the friction of a joint.

    Args:
        effects: Friction of one joint that the simulator has no field for.
        exact: Values of the fields that are exact, by field.
        moved: Motions, and the rigid body along each.
        fields: Fields that the simulator has, of ``FIELDS``.
    """
    (j,) = {effect.joints[0] for effect in effects}
    v = np.concatenate([m.v[m.mask, j] for m, _ in moved])
    laws = [
        sum((e.torque(m, body)[m.mask, 0] for e in effects), np.zeros(m.mask.sum()))
        for m, body in moved
    ]
    pull = exact.get("preload", 0.0)  # of springs, which is no friction
    torque = np.concatenate(laws) + curve(exact, v) - pull
    parts = list(_parts(float(np.abs(v).max()), fields))
    A = np.stack([curve(x, v) for x in parts], axis=1)  # (N, parts)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    both = np.linalg.qr(np.c_[A / size, torque], mode="reduced").R
    share = nnls(both[:, :-1], both[:, -1])[0] / size
    table = np.array([[x.get(name, 0.0) for name in fields] for x in parts])
    values = dict(zip(fields, (share @ table).tolist(), strict=True))
    missed = torque - curve(values, v)
    rms = [float(np.sqrt(np.mean(x**2))) for x in (missed, torque)]
    if "preload" in values:
        values["preload"] += pull
    return StandIn(j, tuple(effects), values, *rms)


def curve(values: Mapping[str, float], v: Array) -> Array:
    """Torque at speeds of the fields of a joint, [N·m]."""
    level, linear, quadratic, cubic, preload = (
        values.get(x, 0.0)
        for x in ("frictionloss", "damping", "quadratic", "cubic", "preload")
    )
    speed = np.abs(v)
    bent = (linear + (quadratic + cubic * speed) * speed) * v
    return np.asarray(level * np.sign(v) + bent + preload)


def _parts(fastest: float, fields: Collection[str]) -> Iterator[dict[str, float]]:
    """Frictions of which others are sums, none of them below zero."""
    for name in FRICTION:
        if name in fields:
            yield {name: 1.0}
    if "preload" in fields:
        yield from ({"frictionloss": 1.0, "preload": x} for x in (-1.0, 1.0))
    if {"quadratic", "cubic"} <= set(fields) and fastest > 0:
        for w in fastest * _BENDS:
            yield {"damping": 1.0, "quadratic": -2.0 / w, "cubic": 1.0 / w**2}
