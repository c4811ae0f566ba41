"""A friction curve that a simulator has no field for, as the nearest that it has.

Friction is fitted as frictionloss·sgn v + damping·v + quadratic·v|v| + cubic·v³, and
two levels of dry friction where a joint may have a preload, over the samples of
motions, each of which weighs the same. It is a sum of parts that each take energy at
every speed, none below zero: v(1 − |v|/w)² for some w is what makes the sum bend
downwards. Where a joint may have it, knee·clip(v/w) is added, for the w that leaves
least.
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
_KNEES = np.geomspace(0.01, 1.0, 13)  # w, of the highest speed


@dataclass(frozen=True)
class StandIn:
    """What stands in for the friction of a joint.

    Attributes:
        joint: The joint, counted from 0.
        effects: Effects of which the friction is the sum, beside exact ones.
        values: ``frictionloss``, ``damping``, ``quadratic``, ``cubic``, ``preload``,
            and ``knee`` with ``knee_speed``, SI units.
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
        exact: Values of the fields that are exact, by field; a ``knee_speed`` without
            a knee is one to try.
        moved: Motions, and the rigid body along each.
        fields: Fields that the simulator has, of ``FIELDS``.
    """
    (j,) = {j for effect in effects for j in effect.joints}
    v = np.concatenate([m.v[m.mask, j] for m, _ in moved])
    laws = [
        sum((e.torque(m, body)[m.mask, 0] for e in effects), np.zeros(m.mask.sum()))
        for m, body in moved
    ]
    pull = exact.get("preload", 0.0)  # of springs, which is no friction
    torque = np.concatenate(laws) + curve(exact, v) - pull
    values = _least(torque, v, fields, exact.get("knee_speed", 0.0))
    missed = torque - curve(values, v)
    rms = [float(np.sqrt(np.mean(x**2))) for x in (missed, torque)]
    if "preload" in values:
        values["preload"] += pull
    return StandIn(j, tuple(effects), values, *rms)


def _least(
    torque: Array, v: Array, fields: Collection[str], known: float
) -> dict[str, float]:
    """Values of fields whose curve leaves least of torques, as a sum of parts."""
    fastest = float(np.abs(v).max())
    smooth = list(_smooth(fastest, fields))
    speeds = fastest * _KNEES if "knee" in fields and fastest > 0 else np.zeros(0)
    smooth += _dry(0.0, fields)
    rising = [list(_dry(w, fields)) for w in (*[known] * (known > 0), *speeds)]
    parts = [*smooth, *(part for own in rising for part in own)]
    A = np.stack([curve(x, v) for x in parts], axis=1)  # (N, parts)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    R = np.linalg.qr(np.c_[A / size, torque], mode="reduced").R
    found, at = [], len(smooth)
    for own in rising or [[]]:
        columns = [*range(len(smooth)), *range(at, at + len(own))]
        share, left = nnls(R[:, columns], R[:, -1])
        found.append((left, columns, share / size[columns]))
        at += len(own)
    _, columns, share = min(found, key=lambda x: x[0])
    values = dict.fromkeys([x for x in fields if x != "knee_speed"], 0.0)
    for c, x in zip(columns, share.tolist(), strict=True):
        for name, unit in parts[c].items():
            if name == "knee_speed":
                values |= {name: unit} if x else {}
            else:
                values[name] += unit * x
    return values


def curve(values: Mapping[str, float], v: Array) -> Array:
    """Torque at speeds of the fields of a joint, [N·m]."""
    level, linear, quadratic, cubic, preload, knee = (
        values.get(x, 0.0)
        for x in ("frictionloss", "damping", "quadratic", "cubic", "preload", "knee")
    )
    speed = np.abs(v)
    bent = (linear + (quadratic + cubic * speed) * speed) * v
    if knee:
        bent = bent + knee * np.clip(v / values["knee_speed"], -1.0, 1.0)
    return np.asarray(level * np.sign(v) + bent + preload)


def _dry(w: float, fields: Collection[str]) -> Iterator[dict[str, float]]:
    """Levels of friction that is dry, or rises to it until the speed ``w``."""
    level = {"knee": 1.0, "knee_speed": w} if w else {"frictionloss": 1.0}
    yield level
    if "preload" in fields:
        yield from ({**level, "preload": x} for x in (-1.0, 1.0))


def _smooth(fastest: float, fields: Collection[str]) -> Iterator[dict[str, float]]:
    """Frictions of which others are sums, none of them below zero."""
    for name in ("damping", "quadratic", "cubic"):
        if name in fields:
            yield {name: 1.0}
    if {"quadratic", "cubic"} <= set(fields) and fastest > 0:
        for w in fastest * _BENDS:
            yield {"damping": 1.0, "quadratic": -2.0 / w, "cubic": 1.0 / w**2}
