"""What a fit of servos says of an arm with one fault, and a table of it."""

from __future__ import annotations

from collections import Counter

import numpy as np
from servo_arms import TICK

from hybrid.report import Table, markdown_table
from hybrid.servo import ServoFit

# Not told apart by motion at all, or shapes of one law.
ALIKE = {
    "stribeck": {"coulomb"}, "encoder_offset": {"torque_offset"},
    "backlash": {"deadzone"},
}  # fmt: skip

ANYWHERE = "payload", "gravity_tilt"  # which are not of one joint


def outcome(fit: ServoFit, fault: str, j: int) -> str:
    """What is said, against what is true."""
    said = {(x.effect, x.joint): {x.effect, *x.equivalents} for x in fit.findings}
    if fault == "none":
        return "right" if not said else f"false: {named(said)}"
    alike, joint = {fault} | ALIKE.get(fault, set()), fit.robot.joints[j]
    here = {x: e for x, e in said.items() if fault in ANYWHERE or x[1] == joint}
    good = {x for x, effects in here.items() if effects & alike}
    others = {x for x in said if x not in good}
    if good:
        right = any(effect == fault for effect, _ in good)
        text = "right" if right else "in class"
        return f"{text}, and {named(others)}" if others else text
    if not (fit.before > TICK).any():
        return f"{named(others)}, does not show" if others else "does not show"
    if fit.after[j] < TICK:
        return f"equivalent: {named(others)}" if others else "nothing"
    unsaid = "abstains" if "no known cause" in fit.sentence else "another"
    return (
        f"{unsaid}: {named(others) or 'nothing'}, {1000 * fit.after[j]:.1f} mrad left"
    )


def named(said) -> str:
    """Effects and joints in words."""
    return ", ".join(f"{effect} at {joint}" for effect, joint in sorted(said))


def table_of(cases: list[dict]) -> str:
    """What was said, faults down and arms across."""
    said: dict[str, dict[str, str]] = {}
    for x in cases:
        said.setdefault(x["fault"], {})[x["arm"]] = f"{x['said']} ({x['joint']})"
    arms = list(dict.fromkeys(x["arm"] for x in cases))
    rows = tuple((f, *(said[f].get(a, "") for a in arms)) for f in said)
    counts = Counter(x["said"].split(":")[0] for x in cases)
    told = ", ".join(f"{v} {k}" for k, v in counts.most_common())
    seconds = np.median([x["seconds"] for x in cases])
    text = markdown_table(Table(("", *arms), rows, words=True))
    return f"{text}\n{told}; {seconds:.0f} s of processor time a case (median)\n"
