"""An answer against the sealed truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Effects that a recording of a moving arm splits badly or not at all, and why; only
# where the true effect is left out of the library may another be named instead.
EQUIVALENT: Mapping[str, frozenset[str]] = {
    # The same columns.
    "payload": frozenset({"link_inertia"}),
    "link_inertia": frozenset({"payload"}),
    "delay": frozenset({"actuator_lag"}),
    "actuator_lag": frozenset({"delay"}),
    # The same while the joint moves; a spring's preload is an offset.
    "torque_offset": frozenset({"asymmetric_friction", "spring", "counterbalance"}),
    "asymmetric_friction": frozenset({"torque_offset", "spring", "counterbalance"}),
    # One becomes the other at an end of a shape's range.
    "coulomb": frozenset({"presliding", "deadzone", "stribeck"}),
    "presliding": frozenset({"coulomb"}),
    "viscous": frozenset({"thermal_friction"}),
    "thermal_friction": frozenset({"viscous"}),
    "spring": frozenset({"counterbalance", "torque_ripple"}),
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
        Named(f["effect"], tuple(f["joints"]), tuple(f["class"]))
        for f in diagnosis["findings"]
    )


def score(truth: Mapping[str, Any], causes: Sequence[Named]) -> dict[str, Any]:
    """What of the truth was named, and what else was.

    Args:
        truth: Content of ``truth.json``.
        causes: What a method names, most important first.

    Returns:
        ``strict`` and ``in_class``: whether the first cause is a true effect, at its
        joint; ``localised``: whether its joints are those of a true effect; ``found``:
        how many true effects were named; ``false``: causes that are none; ``declared``:
        whether all that is named is a true effect or a declared equivalent.
    """
    true = truth["effects"]
    joints = [_where(e) for e in true]
    first = causes[0] if causes else None
    right = [
        any(_is(c, e, at) for e, at in zip(true, joints, strict=True)) for c in causes
    ]
    return {
        "named": len(causes),
        "strict": bool(right and right[0])
        and any(first is not None and first.effect == e["means"] for e in true),
        "in_class": bool(right and right[0]),
        "localised": first is not None and any(set(first.joints) == at for at in joints),
        "class_size": len(first.alike) if first else 0,
        "found": sum(
            any(_is(c, e, at) for c in causes)
            for e, at in zip(true, joints, strict=True)
        ),
        "true": len(true),
        "false": [
            [c.effect, *c.joints] for c, ok in zip(causes, right, strict=True) if not ok
        ],
        "declared": all(
            any(_is(c, e, at, more=True) for e, at in zip(true, joints, strict=True))
            for c in causes
        ),
    }


def _where(effect: Mapping[str, Any]) -> set[str]:
    """Joints at which a diagnosis should say that a true effect is."""
    joints = effect["joints"]
    return set(joints[-1:]) if effect["means"] == "link_inertia" else set(joints)


def _is(
    cause: Named, effect: Mapping[str, Any], joints: set[str], *, more: bool = False
) -> bool:
    """Whether a cause is a true effect; ``more`` takes declared equivalents too."""
    accepted = {effect["means"]}
    if more:
        accepted |= EQUIVALENT.get(effect["means"], frozenset())
    # A payload is a change of the last link: one law, two names.
    same = accepted & {cause.effect, *cause.alike}
    whole = cause.effect == "payload" or effect["means"] == "payload"
    here = joints <= set(cause.joints) or (whole and bool(joints & set(cause.joints)))
    return bool(same) and here


def covered(
    truth: Mapping[str, Any], findings: Sequence[Mapping[str, Any]]
) -> tuple[int, int]:
    """How many 95 % intervals of gains hold the true value, of how many.

    Only those of effects that were named by their own name, at their joint.
    """
    inside = total = 0
    for effect in truth["effects"]:
        where = "arm" if effect["scope"] == "arm" else "+".join(sorted(_where(effect)))
        for finding in findings:
            if finding["effect"] != effect["effect"]:
                continue
            for p in finding["parameters"]:
                low, high = p["interval"]
                known = p["name"] in effect["values"] and high > low
                if known and "+".join(sorted(p["joint"].split("+"))) == where:
                    inside += low <= effect["values"][p["name"]] <= high
                    total += 1
    return int(inside), total
