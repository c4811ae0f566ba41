"""Approximate friction that a simulator has no field for by the fields that it has.

Friction is fitted as frictionloss·sgn v + damping·v + quadratic·v|v| + cubic·v³ over
the samples of motions with equal weights, with a level for each direction if a joint
may have a preload. The fit is a sum of dissipative terms with gains of zero or more;
the terms v(1 − |v|/w)² for several w let it curve downwards. If a joint may have it,
knee·clip(v/w) replaces dry friction and fall·exp(−(v/u)²)·sgn v is added, with the w
and u of the least residual. A polynomial runs away beyond its samples. Therefore the
same motions, run up to the highest speed of the joint, count a little, with relative
residuals.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.optimize import nnls

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.instant import FRICTION
from hybrid.effects.stribeck import Stribeck
from hybrid.plant.reference import random_fourier
from hybrid.robot import Robot
from hybrid.signals import Motion

_CURVES = np.geomspace(0.25, 4.0, 9)  # w, of the highest speed
_KNEES = np.geomspace(0.01, 1.0, 13)  # w, of the highest speed
_FALLS = np.geomspace(0.003, 1.0, 25)  # u, of the highest speed
_BEYOND, _EVERY = 0.16, 10  # weight of every tenth sample of the faster motions
_LEAST = 0.005  # of the friction's RMS; a knee or a fall must explain more
_ROUNDS = 2  # of the search for a fall and a knee in turn
_SPEEDS = "knee_speed", "fall_speed"
_SECONDS, _RATE = 20.0, 100.0  # of a typical motion

Parts = list[dict[str, float]]  # each a term, by the values of its fields


@dataclass(frozen=True)
class FittedFriction:
    """Approximated friction of a joint.

    Attributes:
        joint: Index of the joint.
        effects: Effects that are approximated.
        values: ``frictionloss``, ``damping``, ``quadratic``, ``cubic``, ``preload``,
            ``knee`` with ``knee_speed``, and ``fall`` with ``fall_speed``, SI units.
        missed: RMS of the residual, [N·m].
        torque: RMS of the friction, [N·m].
    """

    joint: int
    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    missed: float
    torque: float


def is_friction(effect: Effect) -> bool:
    """Tell whether an effect is a friction of one joint."""
    return len(effect.joints) == 1 and any(
        field in FRICTION for field in effect.fields.values()
    )


def typical_motion(robot: Robot) -> Motion:
    """Random motion at all speeds within the limits of an arm; its torque is NaN."""
    rng = np.random.default_rng(0)
    path = random_fourier(robot, duration=_SECONDS, rate=_RATE, seed=rng, fill=0.95)
    unknown = np.full_like(path.q, np.nan)
    mask = np.ones(len(path.t), dtype=bool)
    return Motion(path.t, path.q, path.v, path.a, unknown, mask, joints=robot.joints)


def approximate_friction(
    effects: Sequence[Effect],
    exact: Mapping[str, float],
    moved: Sequence[tuple[Motion, RigidBody]],
    fields: Collection[str],
    highest: float = 0.0,
    form: Mapping[str, float] | None = None,
) -> FittedFriction:
    """Approximate the friction of a joint.

    Args:
        effects: Friction of one joint that the simulator has no field for.
        exact: Values of fields that already hold other friction of the joint. A
            ``knee_speed`` without a knee is a further speed to try.
        moved: Motions, and the rigid body along each.
        fields: Fields of a joint in the simulator.
        highest: Speed up to which the approximation shall hold, [rad/s].
        form: ``knee_speed`` and ``fall_speed`` to take, 0 for none; by default they
            are searched.
    """
    (j,) = {j for effect in effects for j in effect.joints}
    preload = exact.get("preload", 0.0)  # of a spring, not of friction

    def samples(faster: float = 1.0) -> tuple[Array, Array]:
        """Friction and speed of the joint on the motions, run faster by a factor."""
        runs = [(replace(m, v=faster * m.v), body) for m, body in moved]
        v = np.concatenate([m.v[m.mask, j] for m, _ in runs])
        laws = [
            sum((e.torque(m, body)[m.mask, 0] for e in effects), np.zeros(m.mask.sum()))
            for m, body in runs
        ]
        return np.concatenate(laws) + curve(exact, v) - preload, v

    torque, v = samples()
    fastest = float(np.abs(v).max())
    rms = float(np.sqrt(np.mean(torque**2)))
    ratio = highest / fastest if fastest else 0.0
    faster, speeds = (x[::_EVERY] for x in samples(ratio))
    weight = rms / np.maximum(np.abs(faster), rms or 1.0)
    weight *= _BEYOND if ratio > 1 else 0.0
    values = _fit(
        np.r_[torque, faster],
        np.r_[v, speeds],
        fields,
        exact.get("knee_speed", 0.0),
        form=form,
        weight=np.r_[np.ones_like(v), weight],
        fastest=fastest,
    )
    missed = float(np.sqrt(np.mean((torque - curve(values, v)) ** 2)))
    if "preload" in values:
        values["preload"] += preload
    return FittedFriction(j, tuple(effects), values, missed, rms)


def _fit(
    torque: Array,
    v: Array,
    fields: Collection[str],
    known: float,
    *,
    form: Mapping[str, float] | None = None,
    weight: Array | float = 1.0,
    fastest: float = 0.0,
) -> dict[str, float]:
    """Values of fields with the least weighted residual.

    The best knee and fall are searched in turn, once from no knee and once from the
    best knee.
    """
    fastest = fastest or float(np.abs(v).max())
    always, knees, falls = _parts(fastest, fields, known, form)
    parts = [*always, *chain(*knees), *chain(*falls)]
    A = np.stack([weight * curve(x, v) for x in parts], axis=1)  # (N, parts)
    torque = torque * weight
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    R = np.asarray(np.linalg.qr(np.c_[A / size, torque], mode="r"))
    penalty = float((_LEAST * np.linalg.norm(torque)) ** 2)

    def fit(knee: Parts, fall: Parts) -> tuple[float, Array]:
        """Squared residual with penalties, and the gain of each part."""
        own = {id(x) for x in (*always, *knee, *fall)}
        columns = [k for k, x in enumerate(parts) if id(x) in own]
        gains = np.zeros(len(parts))
        gains[columns], residual = nnls(R[:, columns], R[:, -1])
        return residual**2 + penalty * (bool(knee) + bool(fall)), gains / size

    found = []
    for knee in ([], min(knees, key=lambda x: fit(x, [])[0])):
        for _ in range(_ROUNDS):
            fall = min(falls, key=lambda x, y=knee: fit(y, x)[0])  # type: ignore[misc]
            knee = min(knees, key=lambda x, y=fall: fit(x, y)[0])  # type: ignore[misc]
        found.append(fit(knee, fall))
    _, gains = min(found, key=lambda x: x[0])
    values = dict.fromkeys(fields, 0.0)
    for part, x in zip(parts, gains.tolist(), strict=True):
        for name, unit in part.items() if x else ():
            values[name] = unit if name in _SPEEDS else values[name] + unit * x
    return values


def _parts(
    fastest: float,
    fields: Collection[str],
    known: float,
    form: Mapping[str, float] | None,
) -> tuple[Parts, list[Parts], list[Parts]]:
    """Terms of every fit, and choices of a knee and of a fall; the first is none."""
    rises, drops = [0.0], [0.0]
    if form is not None:
        rises, drops = [form["knee_speed"]], [form["fall_speed"]]
    elif "knee" in fields:
        rises += [w for w in (known, *fastest * _KNEES) if w > 0]
    if form is None and "fall" in fields:
        low, high = Stribeck.shapes[0].lower, Stribeck.shapes[0].upper
        drops += [u for u in fastest * _FALLS if low <= u <= high]
    return (
        [*_smooth(fastest, fields), *_dry(0.0, fields)],
        [list(_dry(w, fields)) if w else [] for w in rises],
        [[{"fall": 1.0, "fall_speed": u}] if u else [] for u in drops],
    )


def curve(values: Mapping[str, float], v: Array) -> Array:
    """Torque of the fields of a joint at speeds, [N·m]."""
    names = "frictionloss", "damping", "quadratic", "cubic", "preload", "knee", "fall"
    level, linear, quadratic, cubic, preload, knee, fall = (
        values.get(x, 0.0) for x in names
    )
    speed = np.abs(v)
    smooth = (linear + (quadratic + cubic * speed) * speed) * v
    if knee:
        smooth = smooth + knee * np.clip(v / values["knee_speed"], -1.0, 1.0)
    dry = np.full_like(v, level)
    if fall:
        dry = level + fall * np.exp(-((v / values["fall_speed"]) ** 2))
    return np.asarray(dry * np.sign(v) + smooth + preload)


def _dry(w: float, fields: Collection[str]) -> Iterator[dict[str, float]]:
    """Terms of dry friction, or of friction that is linear up to the speed ``w``."""
    level = {"knee": 1.0, "knee_speed": w} if w else {"frictionloss": 1.0}
    yield level
    if "preload" in fields:
        yield from ({**level, "preload": x} for x in (-1.0, 1.0))


def _smooth(fastest: float, fields: Collection[str]) -> Iterator[dict[str, float]]:
    """Smooth terms, all dissipative."""
    for name in ("damping", "quadratic", "cubic"):
        if name in fields:
            yield {name: 1.0}
    if {"quadratic", "cubic"} <= set(fields) and fastest > 0:
        for w in fastest * _CURVES:
            yield {"damping": 1.0, "quadratic": -2.0 / w, "cubic": 1.0 / w**2}
