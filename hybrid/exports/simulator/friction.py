"""A friction curve that a simulator has no field for, as the nearest that it has.

Friction is fitted as frictionloss·sgn v + damping·v + quadratic·v|v| + cubic·v³, and
two levels of dry friction where a joint may have a preload, over the samples of
motions, each of which weighs the same. It is a sum of parts that each take energy at
every speed, none below zero: v(1 − |v|/w)² for some w is what makes the sum bend
downwards. Where a joint may have it, dry friction is knee·clip(v/w) instead, and
fall·exp(−(v/u)²)·sgn v is added, for the w and the u that leave least.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.optimize import nnls

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.instant import FRICTION
from hybrid.effects.stribeck import Stribeck
from hybrid.signals import Motion

_BENDS = np.geomspace(0.25, 4.0, 9)  # w, of the highest speed
_KNEES = np.geomspace(0.01, 1.0, 13)  # w, of the highest speed
_FALLS = np.geomspace(0.003, 1.0, 25)  # u, of the highest speed
_WORTH = 0.005  # of the friction's RMS, that a knee or a fall takes if it is there
_TURNS = 2  # of seeking a fall and a knee, each for the best of the other
_SPEEDS = "knee_speed", "fall_speed"

Parts = list[dict[str, float]]  # values of fields of which others are sums


@dataclass(frozen=True)
class StandIn:
    """What stands in for the friction of a joint.

    Attributes:
        joint: The joint, counted from 0.
        effects: Effects of which the friction is the sum, beside exact ones.
        values: ``frictionloss``, ``damping``, ``quadratic``, ``cubic``, ``preload``,
            ``knee`` with ``knee_speed``, and ``fall`` with ``fall_speed``, SI units.
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
    """Values of fields whose curve leaves least of torques, as a sum of parts.

    A knee and a fall are sought in turn, from none and from the best knee.
    """
    always, knees, falls = _parts(float(np.abs(v).max()), fields, known)
    parts = [*always, *chain(*knees), *chain(*falls)]
    A = np.stack([curve(x, v) for x in parts], axis=1)  # (N, parts)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    R = np.linalg.qr(np.c_[A / size, torque], mode="reduced").R
    price = float((_WORTH * np.linalg.norm(torque)) ** 2)

    def fit(rise: Parts, fall: Parts) -> tuple[float, Array]:
        """Squares that parts leave and cost, and how much there is of each."""
        own = {id(x) for x in (*always, *rise, *fall)}
        columns = [k for k, x in enumerate(parts) if id(x) in own]
        share = np.zeros(len(parts))
        share[columns], rest = nnls(R[:, columns], R[:, -1])
        return rest**2 + price * (bool(rise) + bool(fall)), share / size

    found = []
    for rise in ([], min(knees, key=lambda x: fit(x, [])[0])):
        for _ in range(_TURNS):
            fall = min(falls, key=lambda x, y=rise: fit(y, x)[0])  # type: ignore[misc]
            rise = min(knees, key=lambda x, y=fall: fit(x, y)[0])  # type: ignore[misc]
        found.append(fit(rise, fall))
    _, share = min(found, key=lambda x: x[0])
    values = dict.fromkeys(fields, 0.0)
    for part, x in zip(parts, share.tolist(), strict=True):
        for name, unit in part.items() if x else ():
            values[name] = unit if name in _SPEEDS else values[name] + unit * x
    return values


def _parts(
    fastest: float, fields: Collection[str], known: float
) -> tuple[Parts, list[Parts], list[Parts]]:
    """Parts of any sum, and the choices of a knee and of a fall, none at first."""
    always = [*_smooth(fastest, fields), *_dry(0.0, fields)]
    knees: list[Parts] = [[]]
    falls: list[Parts] = [[]]
    if "knee" in fields:
        speeds = known, *fastest * _KNEES
        knees += [list(_dry(w, fields)) for w in speeds if w > 0]
    if "fall" in fields:
        low, high = Stribeck.shapes[0].lower, Stribeck.shapes[0].upper
        falls += [
            [{"fall": 1.0, "fall_speed": u}]
            for u in fastest * _FALLS if low <= u <= high
        ]  # fmt: skip
    return always, knees, falls


def curve(values: Mapping[str, float], v: Array) -> Array:
    """Torque at speeds of the fields of a joint, [N·m]."""
    names = "frictionloss", "damping", "quadratic", "cubic", "preload", "knee", "fall"
    level, linear, quadratic, cubic, preload, knee, fall = (
        values.get(x, 0.0) for x in names
    )
    speed = np.abs(v)
    bent = (linear + (quadratic + cubic * speed) * speed) * v
    if knee:
        bent = bent + knee * np.clip(v / values["knee_speed"], -1.0, 1.0)
    dry = np.full_like(v, level)
    if fall:
        dry = level + fall * np.exp(-((v / values["fall_speed"]) ** 2))
    return np.asarray(dry * np.sign(v) + bent + preload)


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
