"""The grammar of labels: which channel of which joint a column's label stands for.

A label is words for a channel, before or after a joint's name or number, and perhaps a
unit: ``q1``, ``actual_q_0``, ``elbow.pos``, ``/joint_states/elbow/position``,
``effort[2]``, ``position_elbow [deg]``. What is measured and what is commanded are told
by the words beside the quantity.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import groupby

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
_COMMANDED = set(
    "cmd command commands commanded target desired des ref reference setpoint goal "
    "action qref qcmd d".split()
)
_MEASURED = set(
    "actual act measured meas state states observation observations obs feedback "
    "present fb".split()
)
# Of no joint, or no channel: accelerations, estimates, limits, the tool.
_OTHER = set(
    "acc accel acceleration accelerations ddq qdd dddq error err ext external output "
    "raw std min max limit eef ee tcp cos sin cartesian pose quat dtau dtauj".split()
)
LONGEST = 300  # characters of a label; more are no words
_QUALIFIES = ("commanded", "measured", "other")  # kinds of words
_MOTOR = ("motor", "rotor")
_TAU = ("tau", "dtau")
_TOKEN = re.compile(r"\d+|(?:[^\W\d_](?!(?<=[a-z]{2})(?=[A-Z])))*[^\W\d_]")
_UNIT = re.compile(r"\s*[\[(]([^\[\]()]+)[\])]$")
_SUFFIX = re.compile(
    r"_(rad_s|rad_per_s|deg_s|deg_per_s|rad|deg|degrees|rpm|Nm|mNm|N_m|mA|A|degC|C|"
    r"[mun]s|sec|seconds|nanoseconds|milliseconds|microseconds|ns|nsec|msec|usec)$"
)
_NUMBER = re.compile(r"\[?(\d+)\]?")
_SEPARATORS = " _./:[]-"


@dataclass(frozen=True)
class Meaning:
    """What a label says.

    Attributes:
        channel: Field of a recording, or ``current``; empty if it is none.
        joint: Name or number of the joint as written; empty for a bare word.
        number: The number, if the label counts joints; None if it names them.
        space: What stands before the words, such as a topic; empty if nothing.
        unit: Unit that the label states; empty if none.
        why: Why it is no channel of a joint; empty if it is one.
        index: Place of the label among those of a table, from 0.
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
    """Whether a label without its unit means time."""
    word = label.strip().lower()
    return word in TIME or word.endswith(("/stamp", ".stamp", "/__time", ".__time"))


def split_unit(label: str) -> tuple[str, str]:
    """A label without its unit, and the unit; other brackets hold a joint."""
    label = label.strip()
    if len(label) > LONGEST:
        return label, ""
    if (match := _UNIT.search(label)) and fits(unit := match.group(1).strip()):
        word = label[: match.start()]
        said = _meant(word)
        channel = "time" if is_time(word) else said.channel
        # q[a] is joint a, not a year; q1 [a] is in years, and will be refused.
        apart = said.joint if channel else match.group()[0] in " ("
        if apart or (channel and fits(unit, channel)):
            return word, unit
    if match := _SUFFIX.search(label):
        word, unit = label[: match.start()], match.group(1)
        meant = "time" if is_time(word) else _meant(word).channel
        if meant and fits(unit, meant):
            return word, unit
    return label, ""


def meaning(label: str, joints: tuple[str, ...] = ()) -> Meaning:
    """Read a label, in which names of known joints come before any other word."""
    if len(label) > LONGEST:
        return Meaning(why=f"a label of more than {LONGEST} characters")
    # 'q_A' is joint A, not a current
    for text, unit in ((label.strip(), ""), split_unit(label)):
        named = _named(text, joints)
        if named is not None:
            return replace(named, unit=unit)
    text, unit = split_unit(label)
    return replace(_meant(text), unit=unit)


def _named(text: str, joints: tuple[str, ...]) -> Meaning | None:
    """The meaning of a label around the name of a known joint."""
    for joint in sorted(joints, key=len, reverse=True):
        at = text.lower().rfind(joint.lower())
        before, after = text[: max(at, 0)], text[at + len(joint) :]
        if at < 0 or joint.isdigit() or before[-1:].isalnum() or after[:1].isalnum():
            continue
        ahead, behind = _words(before), _words(after)
        channel, why = _channel_of([w for w in ahead + behind if w.kind != "name"])
        if channel and not any(w.kind in ("name", "number") for w in behind):
            if not any(w.kind in ("name", "number") for w in ahead):
                return Meaning(channel, joint, why="")
            if any(w.kind == "quantity" for w in ahead):
                continue
            return Meaning(channel, joint, None, before.strip(_SEPARATORS), why="")
        if why:
            return Meaning(why=why)
    return None


def _meant(text: str) -> Meaning:
    words = _words(text)
    phrase = _phrase(words)
    if not phrase:
        return Meaning()
    after = text[phrase[-1].end :].strip(" _./:-")
    before = text[: phrase[0].start].strip(" _./:-")
    tail = _words(after)
    while tail and tail[-1].kind in _QUALIFIES:
        phrase.append(tail.pop())
        after = after[: tail[-1].end].strip(" _./:-") if tail else ""
    # Parts of a path may only qualify (reference, action), and name nothing.
    for part in re.split(r"[/.]", before):
        words = _words(part)
        if words and all(w.kind in _QUALIFIES for w in words):
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
    """The run of words that holds the quantity: the first one, or else the last."""
    runs = [list(run) for named, run in
            groupby(words, lambda w: w.kind in ("name", "number"))
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
        kind = "name"
        if token.isdigit():
            kind = "number"
        elif token in _QUANTITY:
            kind = "quantity"
        elif token in _OTHER:
            kind = "other"
        elif token in _MEASURED:
            kind = "measured"
        elif token in _COMMANDED and (token != "d" or (found and found[-1].channel)):
            kind = "commanded"
        found.append(_Word(kind, _QUANTITY.get(token, ""), start, end))
    return found
