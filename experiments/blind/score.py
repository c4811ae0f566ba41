"""An answer against the sealed truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Effects that a recording of a moving arm splits badly or not at all, and why. Only
# where the true effect is left out of the library may another be named instead.
EQUIVALENT: Mapping[str, frozenset[str]] = {
    # The same columns; a rotor's are those of the first link.
    "payload": frozenset({"link_inertia"}),
    "link_inertia": frozenset({"payload", "armature"}),
    "armature": frozenset({"link_inertia"}),
    "delay": frozenset({"actuator_lag"}),
    "actuator_lag": frozenset({"delay"}),
    # The same while the joint moves; a spring's preload is an offset.
    "torque_offset": frozenset({"asymmetric_friction", "spring", "counterbalance"}),
    "asymmetric_friction": frozenset({"torque_offset", "spring", "counterbalance"}),
    # One becomes the other at an end of a shape's range.
    "coulomb": frozenset({"presliding", "deadzone", "stribeck"}),
    "presliding": frozenset({"coulomb"}),
    "viscous": frozenset({"thermal_friction", "friction_lag"}),
    "thermal_friction": frozenset({"viscous"}),
    "friction_lag": frozenset({"viscous"}),
    "torque_gain": frozenset({"saturation", "deadzone"}),
    "spring": frozenset({"counterbalance", "torque_ripple", "stiffening_spring"}),
    "stiffening_spring": frozenset({"spring", "counterbalance"}),
    "counterbalance": frozenset({"spring", "torque_ripple"}),
}


@dataclass(frozen=True)
class Named:
    """One cause that a method names.

    Attributes:
        effect: Its id.
        joints: Names of its joints.
        alike: Ids that it cannot be told from, itself first.
    """

    effect: str
    joints: tuple[str, ...]
    alike: tuple[str, ...]


def named_causes(diagnosis: Mapping[str, Any]) -> tuple[Named, ...]:
    """The causes of a diagnosis in the form of its JSON, first first."""
    return tuple(
        Named(f["effect"], tuple(f["joints"]), tuple(x["effect"] for x in f["class"]))
        for f in diagnosis["findings"]
    )


def score(truth: Mapping[str, Any], causes: Sequence[Named]) -> dict[str, Any]:
    """What of the truth was named, and what else was.

    Args:
        truth: Content of ``truth.json``.
        causes: What a method names, most important first.

    Returns:
        ``strict`` and ``in_class``: whether the first cause is a true effect, at its
        joint, by its own name or in its class; ``localised``: whether the first cause
        is at the joints of a true effect and at no other; ``found``: how many true
        effects were named; ``false``: causes, or joints of one, that are none;
        ``declared``: whether all that is named is a true effect or declared to be
        equivalent to one.
    """
    true = truth["effects"]
    right = [[e for e in true if _is(c, e)] for c in causes]
    first = causes[0] if causes else None
    return {
        "named": [[c.effect, *c.joints] for c in causes],
        "strict": first is not None
        and any(first.effect == e["means"] for e in right[0]),
        "in_class": first is not None and bool(right[0]),
        "localised": first is not None
        and any(set(first.joints) == joints_of(e) or _whole(first, e) for e in true),
        "class_size": len(first.alike) if first else 0,
        "found": sum(any(_is(c, e) for c in causes) for e in true),
        "false": [
            [c.effect, *stray]
            for c, found in zip(causes, right, strict=True)
            if (stray := _stray(c, found))
        ],
        "declared": all(
            not _stray(c, [e for e in true if _is(c, e, also=EQUIVALENT)])
            for c in causes
        ),
    }


def joints_of(effect: Mapping[str, Any]) -> set[str]:
    """Joints at which a diagnosis should say that a true effect is."""
    joints = effect["joints"]
    return set(joints[-1:]) if effect["means"] == "link_inertia" else set(joints)


def _is(
    cause: Named,
    effect: Mapping[str, Any],
    *,
    also: Mapping[str, frozenset[str]] | None = None,
) -> bool:
    """Whether a cause is a true effect, or ``also`` lists it as equivalent."""
    accepted = {effect["means"], *(also or {}).get(effect["means"], ())}
    here = joints_of(effect) <= set(cause.joints) or _whole(cause, effect)
    return here and not accepted.isdisjoint({cause.effect, *cause.alike})


def _whole(cause: Named, effect: Mapping[str, Any]) -> bool:
    """Whether one is a payload and the other a change of the link that carries it."""
    bodies = {"payload", "link_inertia"}
    same = cause.effect in bodies and effect["means"] in bodies
    return same and effect["joints"][-1] in cause.joints


def _stray(cause: Named, found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Joints of a cause at which none of the true effects that it stands for is."""
    if any(_whole(cause, e) for e in found):
        return []
    known = {joint for e in found for joint in joints_of(e)}
    return [joint for joint in cause.joints if joint not in known]


def covered(
    truth: Mapping[str, Any], findings: Sequence[Mapping[str, Any]]
) -> tuple[int, int]:
    """How many 95 % intervals of gains hold the true value, of how many.

    Only those of effects that were named by their own name, at their joint.
    """
    inside = total = 0
    for effect in truth["effects"]:
        where = {"arm"} if effect["scope"] == "arm" else joints_of(effect)
        for finding in findings:
            if finding["effect"] != effect["effect"]:
                continue
            for p in finding["parameters"]:
                low, high = p["interval"]
                known = p["name"] in effect["values"] and high > low
                if known and set(p["joint"].split("+")) == where:
                    inside += low <= effect["values"][p["name"]] <= high
                    total += 1
    return int(inside), total
