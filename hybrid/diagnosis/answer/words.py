"""Put a diagnosis into sentences, for a page and for a terminal."""

from collections.abc import Iterator, Sequence

import numpy as np

from hybrid.diagnosis.answer.diagnosis import (
    ABOVE,
    EXPLAINED,
    Diagnosis,
    Finding,
    Region,
    Shrink,
    Value,
    listed,
)
from hybrid.effects import effect_classes
from hybrid.shown import decimals_of

MOST_LINES, LEAST_FINDINGS = 10, 3
_MOST_TEXTS = 3  # in a line
_TORQUE = "N·m"
_NUMBERS = "other link masses and inertias"
_SAME = 0.005  # a smaller relative difference is not shown
_NO_BREAK = "\u00a0"  # between a number and its unit


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict of a diagnosis in a sentence."""
    count, explained = len(diagnosis.findings), 1.0 - diagnosis.unexplained
    effects = "one effect" if count == 1 else f"{count} effects"
    if not diagnosis.has_usual_numbers:
        effects, count = f"{effects} and {_NUMBERS}", 2
    part = "over 99%" if explained >= 0.995 else f"{explained:.0%}"
    part = f"{effects} account{'s' * (count == 1)} for {part}"
    return {
        "no_gap": "No gap: only noise is left, and the usual errors of robot files.",
        "explained": f"Explained: {part} of the gap above noise.",
        "partly_explained": f"Partly explained: {_joints_explained(diagnosis)}; of the "
        "rest no cause is certain.",
        "unexplained": "Unexplained: there is a gap, and no known effect is its cause.",
        "not_excited": "Not excited: these recordings move the arm too little to tell.",
    }[diagnosis.verdict]


def _joints_explained(diagnosis: Diagnosis) -> str:
    """The number of joints whose gap on held-out motion the findings explain."""
    each = map(diagnosis.unknown_at, range(len(diagnosis.joints)))
    unknown = [x for x in each if x is not None]
    count = sum(x <= 1.0 - EXPLAINED for x in unknown)
    if not count:
        return "the gap at no joint in full"
    return f"nearly all of the gap at {count} of {len(unknown)} joints"


def headline(diagnosis: Diagnosis) -> str:
    """The first effects with their joints, and the gap that is left, in a few words."""
    # That the file is not of this arm comes before: effects then make up for it.
    named = [
        f"{effect_words(f.effect)} at {joints_named(f.joints)}"
        for f in diagnosis.findings
    ]
    where, causes = joints_named(gap_joints(diagnosis)), _few(named, ", ", "effect")
    if not diagnosis.has_usual_numbers:
        causes += f", {_NUMBERS}"
    text = {
        "no_gap": _fits(diagnosis),
        "not_excited": "the recordings move the arm too little to tell",
        "unexplained": f"no known cause of the gap at {where}",
    }.get(diagnosis.verdict, f"{causes}; {_rest(diagnosis)}")
    if diagnosis.unlike:
        text = f"not the file of this arm: {diagnosis.unlike}; {text}"
    return text[:1].upper() + text[1:]


def _fits(diagnosis: Diagnosis) -> str:
    """That there is no gap, or that small errors of the simulator's numbers are one."""
    fits = "the simulator fits the robot"
    if not (joints := gap_joints(diagnosis)):
        return fits
    k = diagnosis.joints.index(joints[0])
    size = f"{number(diagnosis.rms[k])}{_NO_BREAK}{_unit(diagnosis, k)}"
    return (
        f"{fits} within the usual errors of its numbers, which add most at "
        f"{joints[0]}: {size}, noise {number(diagnosis.noise_floor[k])}"
    )


def _rest(diagnosis: Diagnosis) -> str:
    """The gap that is left, and the joint with most of it."""
    rest, unseen = diagnosis.unexplained, list(_unseen(diagnosis))
    if rest < 0.005 and all(x["named"] <= ABOVE * x["noise"] for *_, x in unseen):
        return "noise is left"
    if not unseen:
        return f"{rest:.0%} of the gap is left"
    joint, end, x = max(unseen, key=lambda x: x[2]["named"] - x[2]["noise"])
    whole = f"{number(x['before'])}{end or _NO_BREAK + _TORQUE}"
    left = f"none of {whole} has a certain cause"
    if x["named"] < x["before"]:
        left = f"{number(x['named'])} of {whole}"
    if x["after"] < (1.0 - _SAME) * min(x["named"], x["before"]):
        left += f", the written simulator leaves {number(x['after'])}"
    return f"most is left at {joint}: {left}, noise {number(x['noise'])}"


def joints_named(names: Sequence[str]) -> str:
    """Names of up to two joints, or the number of joints."""
    return listed(names) if len(names) <= 2 else f"{len(names)} joints"


def gap_joints(diagnosis: Diagnosis) -> list[str]:
    """Joints with a gap above noise, largest ratio first."""
    gaps = zip(diagnosis.rms, diagnosis.noise_floor, diagnosis.joints, strict=True)
    over = [(rms / max(noise, 1e-12), joint) for rms, noise, joint in gaps]
    return [joint for ratio, joint in sorted(over, reverse=True) if ratio > ABOVE]


def verdict_lines(diagnosis: Diagnosis) -> list[str]:
    """Verdict, gap, findings and advice in ten lines, or what three findings need."""
    begin = [headline(diagnosis), verdict_sentence(diagnosis)]
    begin += [f"Doubts: {_few(diagnosis.doubts)}"] if diagnosis.doubts else []
    begin += [*_places(diagnosis), *_left(diagnosis)]
    end = list(_endings(diagnosis))
    room = max(MOST_LINES - len(begin) - len(end), LEAST_FINDINGS + 1)
    entries = [list(_entry(k + 1, f)) for k, f in enumerate(diagnosis.findings)]
    if sum(map(len, entries)) > room:
        entries = [entry[:1] for entry in entries]
    lines = [line for entry in entries for line in entry]
    if len(lines) > room:
        lines = [*lines[: room - 1], f"… and {len(lines) - room + 1} more"]
    return [*begin, *lines, *end]


def _places(diagnosis: Diagnosis) -> Iterator[str]:
    """Joints with a gap, and the conditions under which it is densest."""
    named = [
        f"{diagnosis.joints[k]} {number(diagnosis.rms[k])}{_other_unit(diagnosis, k)} "
        f"(noise {number(diagnosis.noise_floor[k])})"
        for k in map(diagnosis.joints.index, gap_joints(diagnosis))
    ]
    if diagnosis.verdict in ("no_gap", "not_excited") or not named:
        return
    yield f"RMS gap in {_TORQUE}: {_few(named, between=', ')}"
    for first in [r for r in diagnosis.where if r.variable != "link"][:1]:
        yield f"Densest: {region_name(first)}, {first.share:.0%} of the whole gap"


def _unseen(diagnosis: Diagnosis) -> Iterator[tuple[str, str, dict[str, float]]]:
    """Joint, its unit if not N·m, and its gaps on held-out motion; largest first."""
    unseen, joints = diagnosis.unseen, diagnosis.joints
    if unseen is None or not diagnosis.findings:
        return
    names = ("before", "after", "least_squares", "noise", "named")
    for i in np.argsort(-np.nan_to_num(unseen.before)).tolist():
        if np.isfinite(unseen.after[i]):
            gaps = {name: getattr(unseen, name)[i] for name in names}
            yield joints[i], _other_unit(diagnosis, i), gaps


def repaired(diagnosis: Diagnosis) -> str:
    """What the repaired simulator holds: the findings, perhaps unnamed effects too."""
    gaps = [(x["named"], x["after"]) for *_, x in _unseen(diagnosis)]
    alike = all(np.isclose(*pair, rtol=_SAME) for pair in gaps)
    return "repaired" if alike else "repaired, unnamed effects included"


def _unit(diagnosis: Diagnosis, joint: int) -> str:
    return diagnosis.units[joint] if diagnosis.units else _TORQUE


def _other_unit(diagnosis: Diagnosis, joint: int) -> str:
    """Unit of a joint's torque after a number; empty for N·m."""
    unit = _unit(diagnosis, joint)
    return "" if unit == _TORQUE else _NO_BREAK + unit


def cautions(diagnosis: Diagnosis) -> list[str]:
    """Joints where the findings leave a gap, or more than least squares leaves."""
    named = {joint for f in diagnosis.findings for joint in f.joints}
    unknown, worse = list[str](), list[str]()
    for joint, end, x in _unseen(diagnosis):
        if joint not in named and x["named"] > ABOVE * x["noise"]:
            unknown.append(f"{joint} {number(x['named'])}{end}")
        if x["after"] > ABOVE * x["least_squares"]:
            worse.append(f"{joint} {number(x['least_squares'])}{end}")
    said = {"no known cause": unknown, "least squares alone leaves less": worse}
    return [f"{k} at {_few(x, between=', ')}" for k, x in said.items() if x]


def _left(diagnosis: Diagnosis) -> Iterator[str]:
    """The gap of each joint with a finding on held-out motion, and the cautions."""
    named = {joint for f in diagnosis.findings for joint in f.joints}
    falls = [
        f"{joint} {number(x['before'])} → {number(x['after'])}{end}"
        for joint, end, x in _unseen(diagnosis)
        if joint in named
    ]
    parts = cautions(diagnosis)
    if falls:
        parts = [f"{repaired(diagnosis)}, {_few(falls, between=', ')}", *parts]
    if parts:
        yield f"On held-out motion, in {_TORQUE}: {'; '.join(parts)}"


def probability(f: Finding) -> list[str]:
    """How probable it is that the effect or an alternative is there, if known."""
    if np.isnan(f.probability):
        return []
    return [
        "over 99% probable" if f.probability > 0.99 else f"{f.probability:.0%} probable"
    ]


def _entry(number: int, f: Finding) -> Iterator[str]:
    line = f"{number}. {effect_name(f.effect)} at {listed(f.joints)}: "
    line += ", ".join([f"{f.share:.0%} of what is explained", *probability(f)])
    if f.alternatives[1:]:
        line += f"; may as well be {effects_listed(f.alternatives[1:], 'or')}"
    yield line
    shrinks = "; ".join(shrink_sentence(kind, s) for kind, s in f.shrink.items())
    yield from (f"   {text}" for text in (shrinks, f.note) if text)


def pushes(diagnosis: Diagnosis) -> Iterator[str]:
    """A sentence on each contact and push."""
    for e in diagnosis.events:
        joint = int(np.argmax(np.abs(e.torque)))
        torque = f"{number(e.torque[joint])}{_NO_BREAK}{_unit(diagnosis, joint)}"
        yield (
            f"{e.recording}, {number(e.start)} to {number(e.end)}{_NO_BREAK}s: "
            f"{torque} at {diagnosis.joints[joint]}, "
            f"as of {number(float(np.linalg.norm(e.force[:3])))}{_NO_BREAK}N"
        )


def scale_sentence(scale: Value) -> str:
    """How logged torque and true torque compare, by a known mass."""
    value, interval, _ = value_cells(scale)
    return f"Logged torque is {value} of the true torque (95% interval {interval})."


def _endings(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.torque_scale:
        yield scale_sentence(diagnosis.torque_scale)
    if diagnosis.events:
        yield f"Touched or pushed: {_few(list(pushes(diagnosis)))}"
    if diagnosis.not_excited:
        yield f"Not excited, so nothing is said of: {_few(diagnosis.not_excited)}"
    if diagnosis.warnings:
        yield f"Take care: {_few(diagnosis.warnings)}"
    if diagnosis.advice:
        first, splits = diagnosis.advice[0], ""
        if first.splits and "; it " not in first.experiment:
            splits = f", to tell {effects_listed(first.splits, 'from')}"
        yield f"Next: {first.experiment}{splits}"


def shrink_sentence(kind: str, s: Shrink) -> str:
    """The gap without and with a finding, and the part removed."""
    over = f" over {s.horizon_s:g} s" if s.horizon_s is not None else ""
    way, sign, ends = "less", 1, s.interval
    if s.removed < 0:
        way, sign, ends = "more", -1, s.interval[::-1]
    size, low, high = (
        f"{round(100 * sign * x)}".replace("-", "−") for x in (s.removed, *ends)
    )
    return (
        f"{kind} gap{over} {number(s.before)} → {number(s.after)}{_NO_BREAK}{s.unit}, "
        f"{size}% {way} (95% interval {low} to {high}%)"
    )


def region_name(region: Region) -> str:
    """A region in words: ``elbow, speed 0 to 0.1 rad/s``."""
    words = {"link": "all of it from ", "direction": ""}
    name = words.get(region.variable, f"{region.variable.replace('_', ' ')} ")
    return f"{region.joint}, {name}{range_name(region)}"


def region_share(region: Region) -> str:
    """A region's share of the gap with its interval."""
    low, high = region.interval
    return f"{region.share:.0%} of the gap, 95% interval {low:.0%} to {high:.0%}"


def range_name(region: Region) -> str:
    """The range of a region's variable: ``0 to 0.1 rad/s``, ``moving down``."""
    if region.variable == "link":
        return region.unit
    if region.variable == "direction":
        return "moving down" if region.high <= 0 else "moving up"
    ends = f"{number(region.low)} to {number(region.high)}"
    return f"{ends}{_NO_BREAK}{region.unit}".rstrip(_NO_BREAK)


def effect_words(effect_id: str) -> str:
    """An effect's id in words: ``Coulomb friction``, ``torque ripple``."""
    known = effect_classes().get(effect_id)
    return (known and known.words) or effect_id.replace("_", " ")


def effect_name(effect_id: str) -> str:
    """An effect's id in words, with a capital letter."""
    name = effect_words(effect_id)
    return name[:1].upper() + name[1:]


def effects_listed(effect_ids: Sequence[str], last: str) -> str:
    """Effects in words: ``spring, payload or presliding friction``."""
    return listed([*map(effect_words, effect_ids)], last)


def value_cells(value: Value) -> tuple[str, str, str]:
    """A parameter as texts of its value, its interval and its unit."""
    # The half-width of the interval has two significant digits, and the value as many
    # decimals. Without a standard deviation the interval is a dash.
    low, high = value.interval
    half = (high - low) / 2
    if not (half > 0 and np.isfinite(half)):
        return number(value.value, 4), "–", value.unit
    decimals = decimals_of(half, 2)
    mid, low_end, high_end = (
        f"{x:.{decimals}f}".replace("-", "−") for x in (value.value, low, high)
    )
    note = "" if value.determined else ", not determined"
    return mid, f"{low_end} to {high_end}{note}", value.unit


def number(x: float, digits: int = 3) -> str:
    """A number with some significant digits and a typographic minus sign."""
    # One from a thousandth to a million has no exponent.
    return f"{float(f'{x:.{digits}g}'):.6g}".replace("-", "−")


def _few(texts: Sequence[str], between: str = "; ", kind: str = "") -> str:
    """Join the first three texts, and count the others of their kind."""
    rest = len(texts) - _MOST_TEXTS
    kind = f" {kind}{'s' * (rest > 1)}" if kind else ""
    more = f" and {rest} more{kind}" if rest > 0 else ""
    return between.join(texts[:_MOST_TEXTS]) + more
