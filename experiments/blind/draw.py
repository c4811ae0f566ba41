"""Drawing effects as a real arm might have them: where, how large, of which shape."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from blind.independent import INDEPENDENT
from blind.size import Rig
from blind.strangers import STRANGERS
from hybrid.arrays import Array
from hybrid.effects import Effect, Port, effect_classes
from hybrid.errors import EffectError, HybridError

# Sums of other laws, which a fit may choose but no cause has.
_COMPOSITE = {"threshold_friction"}
_ONE_SIDED = {"nonlinear_viscous", "transmission_coupling"}
_RIPPLES = (1, 2, 4, 6, 12, 20, 32, 50, 100, 160, 200)
_SPREAD = 0.5  # of the logarithm of sizes and shapes
_DRAWS = 10
_SMALLEST = 0.3  # residuals of a perfect fit: less cannot be found


def torque_effects() -> tuple[str, ...]:
    """Ids of library effects that leave a trace between motion and torque."""
    return tuple(
        name
        for name, cls in effect_classes().items()
        if cls.port is not Port.COMMAND and name not in _COMPOSITE
    )


def command_effects() -> tuple[str, ...]:
    """Ids of library effects between command and torque."""
    return tuple(n for n, c in effect_classes().items() if c.port is Port.COMMAND)


def draw(
    name: str, rig: Rig, size: float | None, rng: np.random.Generator
) -> Effect | None:
    """An effect at a random place, of random shape, and of a size.

    Args:
        name: Its id, of the library, a stranger's or an independent one's.
        rig: The arm to try it on.
        size: Its size in residuals of a perfect fit; its usual size if not given.
        rng: Source of the draw.

    Returns:
        Nothing if none of ten draws can have that size within physical bounds.
    """
    for _ in range(_DRAWS):
        effect = _usual(name, rig, rng)
        if effect is None:
            continue
        if size is not None:
            effect = rig.scaled(effect, size)
        elif not rig.plausible(effect) or not _felt(effect, rig):
            continue
        if effect is not None:
            return effect
    return None


def _felt(effect: Effect, rig: Rig) -> bool:
    """Whether it can be found; one between command and torque shows elsewhere."""
    if effect.port is Port.COMMAND:
        return True
    try:
        return float(rig.sizes(effect).max()) >= _SMALLEST
    except HybridError:  # the plant swings up
        return False


def _usual(name: str, rig: Rig, rng: np.random.Generator) -> Effect | None:
    """An effect about as large as it usually is."""
    cls = {**effect_classes(), **STRANGERS, **INDEPENDENT}[name]
    if name in STRANGERS or name in INDEPENDENT:
        spots = list(_spots(cls.over, rig.robot.size))
    else:
        spots = list(cls.places(rig.robot.size))
    joints = spots[rng.integers(len(spots))]
    scale = rig.scales[joints[-1]]
    values: dict[str, float] = {}
    for x in (s.scaled(scale) for s in cls.shapes):
        value = x.typical * np.exp(_SPREAD * rng.standard_normal())
        values[x.name] = float(
            np.clip(x.typical if x.whole else value, x.lower, x.upper)
        )
    for x in (g.scaled(scale) for g in cls.gains):
        signed = x.lower < 0 and name not in _ONE_SIDED
        sign = rng.choice([-1.0, 1.0]) if signed else 1.0
        values[x.name] = float(
            sign * x.typical * np.exp(_SPREAD * rng.standard_normal())
        )
    try:
        effect: Effect = cls(joints, values)
        return effect.at(_special(name, effect, rig, rng))
    except EffectError:
        return None


def _spots(over: str, size: int) -> Iterator[tuple[int, ...]]:
    if over == "joint":
        yield from ((j,) for j in range(size))
    elif over == "pair":
        yield from ((j, k) for j in range(size) for k in range(size) if abs(j - k) == 1)
    else:
        yield tuple(range(size))


def _special(
    name: str, effect: Effect, rig: Rig, rng: np.random.Generator
) -> dict[str, float]:
    """Values that no lognormal draw around the usual one describes."""
    values, j = effect.values, effect.joints[-1]
    turn = rng.uniform(0.0, 2 * np.pi)
    if name == "torque_ripple":
        amplitude = abs(values["sine"])
        return {
            "sine": amplitude * np.cos(turn),
            "cosine": amplitude * np.sin(turn),
            "periods": float(rng.choice(_RIPPLES)),
        }
    if name == "encoder_eccentricity":
        amplitude = abs(values["sine"])
        return {"sine": amplitude * np.cos(turn), "cosine": amplitude * np.sin(turn)}
    if name == "thermal_friction":
        return {"time_constant": float(np.exp(rng.uniform(np.log(4), np.log(60))))}
    if name in ("spring", "stiffening_spring"):
        middle = (rig.reference.q[:, j].max() + rig.reference.q[:, j].min()) / 2
        rest = float(middle + rng.uniform(-1.0, 1.0))
        if name == "stiffening_spring":
            return {"rest": rest}
        return {"preload": -values["stiffness"] * rest}
    if name == "counterbalance":
        return {"dead_centre": float(turn - np.pi), "preload": abs(values["preload"])}
    if name == "contact":
        force = np.linalg.norm([values[f"force_{x}"] for x in "xyz"])
        way = rng.standard_normal(3)
        way *= force / np.linalg.norm(way)
        pushes = {f"force_{x}": float(f) for x, f in zip("xyz", way, strict=True)}
        start = rng.uniform(0.5, rig.reference.t[-1] - 2.5)
        return pushes | {"start": start, "duration": rng.uniform(0.3, 2.0)}
    if name in ("saturation", "soft_saturation"):
        limit = np.quantile(np.abs(rig.torque[:, j]), rng.uniform(0.6, 0.95))
        return {"limit": float(limit), "loss": rng.uniform(0.3, 1.0)}
    if name == "payload":
        arm = rig.robot.chain.inertial[:, 0].sum()
        return _lump(rng.uniform(0.02, 0.1) * arm, rng.uniform(-0.1, 0.1, 3), rng)
    if name == "link_inertia":
        mass = max(float(rig.robot.chain.inertial[j, 0]), 0.1)
        return _lump(rng.uniform(0.05, 0.2) * mass, rng.uniform(-0.15, 0.15, 3), rng)
    return {}


def _lump(mass: float, centre: Array, rng: np.random.Generator) -> dict[str, float]:
    """The ten parameters of a box with its centre somewhere."""
    edges = rng.uniform(0.04, 0.15, 3) ** 2
    about = mass / 12 * np.diag(edges.sum() - edges)
    about += mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    first = mass * centre
    names = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    second = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    values = {"mass": mass, "mx": first[0], "my": first[1], "mz": first[2]}
    values |= dict(zip(names, second, strict=True))
    return {k: float(x) for k, x in values.items()}
