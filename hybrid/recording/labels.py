"""Parse the label of a column: its channel, joint and unit.

A label consists of words for a channel, a joint's name or number before or after them,
and sometimes a unit: ``q1``, ``actual_q_0``, ``elbow.pos``, ``effort[2]``,
``/joint_states/elbow/position``, ``position_elbow [deg]``. Further words tell measured
values from commanded ones.
"""

import re
from dataclasses import dataclass, replace
from itertools import groupby

from hybrid.recording.recording import CHANNELS
from hybrid.recording.units import fits

TIME = (
    "t", "time", "timestamp", "time_s", "t_s", "__time", "%time", "stamp", "datetime"
)  # fmt: skip
CHANNEL_WORDS = {
    "q": "q pos position positions angle angles qpos",
    "tau": "tau tauj torque torques effort efforts moment moments",
    "v": "v dq qd vel velocity velocities speed speeds qvel",
    "current": "current currents",
    "temperature": "temp temperature temperatures",
}
_QUANTITY = {w: c for c, words in CHANNEL_WORDS.items() for w in words.split()}
_QUALIFIERS = {
    "commanded": "cmd command commands commanded target desired des ref reference "
    "setpoint goal action qref qcmd d",
    "measured": "actual act measured meas state states observation observations obs "
    "feedback present fb",
    # Quantities that are not read: accelerations, estimates, limits, the tool.
    "other": "acc accel acceleration accelerations ddq qdd dddq error err ext external "
    "output raw std min max limit eef ee tcp cos sin cartesian pose quat dtau dtauj",
}
_KIND = {w: kind for kind, words in _QUALIFIERS.items() for w in words.split()}
_KIND |= dict.fromkeys(_QUANTITY, "quantity")
LONGEST = 300  # characters of a label that is parsed
_MOTOR = ("motor", "rotor")
_TAU = ("tau", "dtau")
_TOKEN = re.compile(r"\d+|(?:[^\W\d_](?!(?<=[a-z]{2})(?=[A-Z])))*[^\W\d_]")
_UNIT = re.compile(r"\s*[\[(](?P<unit>[^\[\]()]+)[\])]$")
_SUFFIX = re.compile(  # a stamp's sec is one of its fields, not its unit
    r"(?:_|(?<!stamp)(\s*/\s*|\s+in\s+))"
    r"(?P<unit>rad_s|rad_per_s|deg_s|deg_per_s|m?rad|deg|degrees|rpm|[mk]?N_?[cm]?m|mA|A|degC|C|"
    r"[mun]s|sec|seconds|nanoseconds|milliseconds|microseconds|ns|nsec|msec|usec|"
    r"(?(1)(?:rad/s|deg/s|°/s|°C?|N[·* ]m|m/s|m|s)))$"
)
_NUMBER = re.compile(r"\[?(\d+)\]?")
_NAMES = ("name", "number")  # kinds of words that tell joints
_SEPARATORS = " _./:[]-"
_SYMBOL = re.compile(r"[^\w\s./:()\[\]-]")


@dataclass(frozen=True)
class Meaning:
    """Meaning of a label.

    Attributes:
        channel: Field of a recording, or ``current``; empty if there is none.
        joint: Name or number of the joint as written; empty if there is none.
        number: Number of the joint; None if the label has a name.
        space: Text before the words, such as a topic.
        unit: Unit that the label states; empty if there is none.
        why: Reason why the label is no channel of a joint; empty if it is one.
        index: Index of the column in its table.
    """

    channel: str = ""
    joint: str = ""
    number: int | None = None
    space: str = ""
    unit: str = ""
    why: str = "no word for a channel"
    index: int = -1


@dataclass(frozen=True)
class _Word:
    kind: str  # quantity, commanded, measured, other, number or name
    channel: str
    start: int
    end: int


def is_time(label: str) -> bool:
    """Tell whether a label without its unit means time."""
    word = label.strip().lower()
    return word in TIME or word.endswith(("/stamp", ".stamp", "/__time", ".__time"))


def split_unit(label: str) -> tuple[str, str]:
    """Split a label into text and unit; brackets without a unit hold a joint."""
    label = label.strip()
    if len(label) > LONGEST:
        return label, ""
    for pattern in (_UNIT, _SUFFIX):
        if not (match := pattern.search(label)):
            continue
        text, unit = label[: match.start()], match["unit"].strip()
        meaning = _parse(text)
        channel = "time" if is_time(text) else meaning.channel
        # q[a] is joint a, not a year; q1 [a] is in years, and will be refused.
        apart = meaning.joint if channel else match.group()[0] in " ("
        other = pattern is _UNIT and apart and fits(unit)
        if other or (channel and fits(unit, channel)):
            return text, unit
    return label, ""


def parse_label(label: str, joints: tuple[str, ...] = ()) -> Meaning:
    """Parse a label; names of known joints take precedence over other words."""
    if len(label) > LONGEST:
        return Meaning(why=f"a label of more than {LONGEST} characters")
    label = label.strip()
    bare, unit = split_unit(label)
    # 'q_A' is joint A, not a current
    texts = [(label, ""), (bare, unit)]
    # Behind a known joint or a number, brackets hold a unit that nobody knows, too.
    if not unit and (match := _UNIT.search(label)):
        if {w.kind for w in _words(match.group(1))} <= {"name"}:
            texts.append((label[: match.start()], match.group(1).strip()))
    for text, own in texts:
        if meaning := _parse_with_joints(text, joints):
            return replace(meaning, unit=own)
    text, own = texts[-1]
    meaning = _parse(text)
    if meaning.number is not None:
        return replace(meaning, unit=own)
    return replace(_parse(bare), unit=unit)


def _parse_with_joints(text: str, joints: tuple[str, ...]) -> Meaning | None:
    """Parse a label that has the name of a known joint; None if it has none.

    Labels as this package writes them come first: names may differ in case alone, or be
    those of channels.
    """
    channel, _, joint = text.partition("_")
    if channel in CHANNELS and joint in joints and not joint.isdigit():
        return Meaning(channel, joint, why="")
    for joint in sorted(joints, key=len, reverse=True):
        at = text.lower().rfind(joint.lower())
        before, after = text[: max(at, 0)], text[at + len(joint) :]
        if at < 0 or joint.isdigit() or before[-1:].isalnum() or after[:1].isalnum():
            continue
        if _SYMBOL.search(after):  # a unit: °, %
            continue
        first, last = _words(before), _words(after)
        channel, why = _channel_of([w for w in first + last if w.kind != "name"])
        if channel and not any(w.kind in _NAMES for w in last):
            named = any(w.kind in _NAMES for w in first)
            if named and any(w.kind == "quantity" for w in first):
                continue
            space = before.strip(_SEPARATORS) if named else ""
            return Meaning(channel, joint, None, space, why="")
        if why:
            return Meaning(why=why)
    return None


def _parse(text: str) -> Meaning:
    words = _words(text)
    phrase = _phrase(words)
    if not phrase:
        return Meaning()
    after = text[phrase[-1].end :].strip(" _./:-")
    before = text[: phrase[0].start].strip(" _./:-")
    tail = _words(after)
    while tail and tail[-1].kind in _QUALIFIERS:
        phrase.append(tail.pop())
        after = after[: tail[-1].end].strip(" _./:-") if tail else ""
    # A part of a path may be a qualifier only (reference, action).
    for part in re.split(r"[/.]", before):
        words = _words(part)
        if words and all(w.kind in _QUALIFIERS for w in words):
            phrase += words
            whole = rf"(^|[/.]){re.escape(part)}(?=$|[/.])"
            before = re.sub(whole, "", before, count=1).strip("/.")
    channel, why = _channel_of(phrase)
    if not channel:
        return Meaning(why=why)
    if after and (match := _NUMBER.fullmatch(after)):
        if before.lower().endswith(_MOTOR) and channel in ("q", "v", "tau"):
            return Meaning(why="of the motor; a map with its gear_ratio says so")
        return Meaning(channel, after, int(match.group(1)), before, why="")
    if after:
        bracketed = after[0] == "[" and after[-1] == "]"
        return Meaning(channel, after[1:-1] if bracketed else after, None, before,
                       why="")  # fmt: skip
    space, _, joint = before.rpartition("/" if "/" in before else ".")
    return Meaning(channel, joint, None, space, why="")


def _phrase(words: list[_Word]) -> list[_Word]:
    """Words around the quantity: the first run of the label, or else the last."""
    runs = [list(run) for named, run in
            groupby(words, lambda w: w.kind in _NAMES)
            if not named]  # fmt: skip
    for kind in ("quantity", "commanded"):
        good = [run for run in runs if any(w.kind == kind for w in run)]
        if good:
            return good[0] if good[0][0] is words[0] else good[-1]
    return []


def _channel_of(words: list[_Word]) -> tuple[str, str]:
    quantities = sorted({w.channel for w in words if w.kind == "quantity"})
    kinds = {w.kind for w in words}
    if "other" in kinds:
        return "", "not a measured or commanded channel of a joint"
    if len(quantities) > 1:
        return "", f"stands for {' and '.join(quantities)}"
    if "commanded" not in kinds:
        return "".join(quantities), ""
    if quantities in ([], ["q"]):
        return "command", ""
    return "", f"commanded, not measured ({quantities[0]})"


def _words(text: str) -> list[_Word]:
    found: list[_Word] = []
    for match in _TOKEN.finditer(text):
        token, start, end = match.group().lower(), match.start(), match.end()
        if token == "j" and found and text[found[-1].start : found[-1].end] in _TAU:
            found[-1] = replace(found[-1], end=end)
            continue
        kind = "number" if token.isdigit() else _KIND.get(token, "name")
        if token == "d" and not (found and found[-1].channel):
            kind = "name"
        found.append(_Word(kind, _QUANTITY.get(token, ""), start, end))
    return found
