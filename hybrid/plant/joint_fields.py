"""Conversion between effects and the fields of a simulator's joint, or a robot file."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.stiffening_spring import StiffeningSpring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.effects.viscous import Viscous
from hybrid.robot import Robot

# Stiffness for a preload without a spring, [N·m/rad]: so soft that the torque is
# constant over the joint's range.
_SOFTEST = 1e-9


def split_effects(
    effects: Sequence[Effect], fields: Collection[str], size: int
) -> tuple[dict[str, Array], list[Effect]]:
    """Split effects into values of joint fields and remaining effects.

    Returns:
        Values of each of the fields, which are some of
        ``hybrid.effects.instant.FIELDS``, shape (n,), and the remaining effects. The
        negative part of a field's sum is an effect again.
    """
    values, rest = {name: np.zeros(size) for name in fields}, []
    for effect in effects:
        left = dict(effect.values)
        for field in values.keys() & set(effect.exact_fields.values()):
            names = [gain for gain, to in effect.exact_fields.items() if to == field]
            share = min(left[name] for name in names)
            if len(names) > 1:  # of both directions: the field has the common level
                share = max(share, 0.0)
            values[field][effect.joints[0]] += share
            left |= {name: left[name] - share for name in names}
        if any(left[g.name] for g in effect.gains):
            rest.append(effect if left == effect.values else effect.at(left))
    unphysical = _unphysical(values)
    for field, x in unphysical.items():
        values[field] -= x
    return values, rest + list(effects_of_fields(unphysical))


def _unphysical(values: Mapping[str, Array]) -> dict[str, Array]:
    """The part of fields that would drive a joint, so that a simulator refuses it."""
    out = {name: np.minimum(x, 0.0) for name, x in values.items()}
    out.pop("preload", None)  # it may have any sign
    if "quadratic" in out:
        # damping + quadratic·|v| + cubic·v² must not be negative.
        linear, cubic = (np.maximum(values[x], 0.0) for x in ("damping", "cubic"))
        least = -2.0 * np.sqrt(linear * cubic)
        out["quadratic"] = np.minimum(values["quadratic"] - least, 0.0)
    return out


def effects_of_fields(values: Mapping[str, Array]) -> Iterator[Effect]:
    """Values of joint fields, shape (n,), as effects, joint by joint."""
    kinds: tuple[type[Effect], ...] = (
        Armature, Viscous, Coulomb, NonlinearViscous, Spring,
    )  # fmt: skip
    for j in range(max((len(x) for x in values.values()), default=0)):
        for cls in kinds:
            own = {
                gain: float(values[field][j])
                for gain, field in cls.fields.items()
                if field in values
            }
            if any(own.values()):
                yield cls((j,), own)


def declared_effects(robot: Robot) -> list[Effect]:
    """Rotors, couplings, friction, ripple and springs of a robot file as effects."""
    names = "damping", "frictionloss", "quadratic", "cubic", "stiffness"
    values = {name: getattr(robot, name) for name in names}
    values["armature"] = robot.chain.armature
    values["preload"] = -robot.stiffness * robot.springref
    springs = [
        StiffeningSpring((int(j),), {"stiffness": k, "rest": rest, "knee": knee})
        for j, k, rest, knee in robot.stiffening.tolist()
    ]
    return [
        *effects_of_fields(values), *curves(robot), *couplings(robot.coupled), *springs,
    ]  # fmt: skip


def curves(robot: Robot) -> list[Effect]:
    """Rising and falling friction, and torque that repeats, of a robot file."""
    rising = [
        knee(int(j), float(robot.knee[j]), float(robot.knee_speed[j]))
        for j in np.flatnonzero(robot.knee)
    ]
    ripples = [
        TorqueRipple((int(j),), {"sine": sine, "cosine": cosine, "periods": k})
        for j, sine, cosine, k in robot.ripple.tolist()
    ]
    rows = robot.falling.tolist()
    return [*rising, *ripples, *(fall(int(j), level, v) for j, level, v in rows)]


def couplings(rows: Array) -> list[Effect]:
    """Rotors that turn with the sum of two joints, from :attr:`.Robot.coupled`."""
    names = [gain.name for gain in TransmissionCoupling.gains]
    return [
        TransmissionCoupling((int(i), int(j)), dict(zip(names, forces, strict=True)))
        for i, j, *forces in rows.tolist()
    ]


def coupled_rows(effects: Sequence[TransmissionCoupling]) -> tuple[Array, list[Effect]]:
    """Couplings as rows of :attr:`.Robot.coupled`, and what they cannot have.

    The sums of values below zero, with which MuJoCo would refuse a file, are effects
    again.
    """
    sums: dict[tuple[int, ...], Array] = {}
    for effect in effects:
        pair = tuple(sorted(effect.joints))
        sums[pair] = sums.get(pair, np.zeros(3)) + effect.gain_values
    rows = np.array([(*pair, *gains) for pair, gains in sums.items()]).reshape(-1, 5)
    pairs, gains = rows[:, :2], rows[:, 2:]
    above = np.c_[pairs, np.maximum(gains, 0.0)][(gains > 0).any(axis=1)]
    below = np.c_[pairs, np.minimum(gains, 0.0)][(gains < 0).any(axis=1)]
    return above, couplings(below)


def fall(joint: int, level: float, speed: float) -> Effect:
    """Friction that falls with speed, as an actuator of MuJoCo has it."""
    values = {"level": level, "velocity": speed, "exponent": 2.0}
    return Stribeck((joint,), values)


def knee(joint: int, level: float, speed: float) -> Effect:
    """Friction that rises linearly to a level at a speed."""
    values = {"rising": level, "threshold": speed, "width": 0.0}
    return ThresholdFriction((joint,), values)


def with_curves(
    robot: Robot, rubbing: Sequence[Effect], has: bool
) -> tuple[Robot, list[Effect]]:
    """Separate friction curves that a simulator has exactly from those to be fitted.

    At a joint with other friction, its curves are to be fitted with it. Friction
    without a field includes falling friction of the file.

    Returns:
        The arm with the exact curves only, and all other friction.
    """
    falling = [
        e for e in rubbing
        if has and isinstance(e, Stribeck)
        and e.values["exponent"] == 2.0 and e.values["level"] > 0
    ]  # fmt: skip
    more = {e.joints for e in rubbing if e not in falling}
    falling = [e for e in falling if e.joints not in more]
    rest = [e for e in rubbing if e not in falling]
    rising = [e for e in curves(robot) if isinstance(e, ThresholdFriction)]
    bent = [e for e in rising if not has or e.joints in more]
    level = robot.knee.copy()
    level[[e.joints[0] for e in bent]] = 0.0
    rows = [(e.joints[0], e.values["level"], e.values["velocity"]) for e in falling]
    own = np.array(rows).reshape(-1, 3)
    return replace(robot, knee=level, falling=own), [*rest, *bent]


def soft_springs(stiffness: Array, preload: Array) -> tuple[Array, Array]:
    """Stiffness [N·m/rad] and relaxed position [rad] of joint springs, shape (n,) each.

    A preload, torque against motion at zero, [N·m], without a spring is a very soft
    spring with a distant relaxed position.
    """
    stiffness = np.where((stiffness == 0) & (preload != 0), _SOFTEST, stiffness)
    return stiffness, -preload / np.where(stiffness > 0, stiffness, 1.0)
