"""The grammar of labels: which channel of which joint a column's label stands for.

A label is words for a channel, before or after a joint's name or number, and perhaps a
unit: ``q1``, ``actual_q_0``, ``elbow.pos``, ``/joint_states/elbow/position``,
``effort[2]``, ``position_elbow [deg]``. What is measured and what is commanded are told
by the words beside the quantity.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

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
    """

    channel: str = ""
    joint: str = ""
    number: int | None = None
    space: str = ""
    unit: str = ""
    why: str = "no word for a channel"


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
    """Read a label.

    Args:
        label: As the file has it.
        joints: Names of joints, which are recognised before any other word.
    """
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
    lower = text.lower()
    for joint in sorted(joints, key=len, reverse=True):
        at = lower.rfind(joint.lower())
        end = at + len(joint)
        if at < 0 or joint.isdigit():
            continue
        if (at and lower[at - 1].isalnum()) or (
            end < len(text) and text[end].isalnum()
        ):
            continue
        before, after = text[:at], text[end:]
        words = [w for part in (before, after) for w in _words(part)]
        channel, why = _channel_of([w for w in words if w.kind != "name"])
        own = [w for w in _words(after) if w.kind in ("name", "number")]
        if channel and not own:
            names = [w for w in _words(before) if w.kind in ("name", "number")]
            space = before if names else ""
            if names and any(w.kind == "quantity" for w in _words(before)):
                continue
            return Meaning(channel, joint, None, space.strip(_SEPARATORS), why="")
        if why:
            return Meaning(why=why)
    return None


def _meant(text: str) -> Meaning:
    words = _words(text)
    if not any(w.kind in ("quantity", "commanded") for w in words):
        return Meaning()
    first, last = _phrase(words)
    phrase = words[first:last]
    after = text[phrase[-1].end :].strip(" _./:-")
    before = text[: phrase[0].start].strip(" _./:-")
    tail = _words(after)
    while tail and tail[-1].kind in _QUALIFIES:
        phrase.append(tail.pop())
        after = after[: tail[-1].end].strip(" _./:-") if tail else ""
    path, before = _qualified(before)
    channel, why = _channel_of([*path, *phrase])
    if not channel:
        return Meaning(why=why)
    if after and (match := _NUMBER.fullmatch(after)):
        if before.lower().endswith(_MOTOR) and channel in ("q", "v", "tau"):
            return Meaning(why="of the motor; a map with its gear_ratio says so")
        return Meaning(channel, after, int(match.group(1)), before, why="")
    if after:
        return Meaning(channel, _unbracketed(after), None, before, why="")
    space, _, joint = before.rpartition("/")
    if not space:
        space, _, joint = before.rpartition(".")
    return Meaning(channel, joint, None, space, why="")


def _qualified(before: str) -> tuple[list[_Word], str]:
    """Parts of a path that only qualify (reference, action), and the path without."""
    found, rest = [], before
    for part in re.split(r"[/.]", before):
        words = _words(part)
        if words and all(w.kind in _QUALIFIES for w in words):
            found += words
            rest = re.sub(rf"(^|[/.]){re.escape(part)}(?=$|[/.])", "", rest, count=1)
    return found, rest.strip("/.")


def _phrase(words: list[_Word]) -> tuple[int, int]:
    """The run of words that holds the quantity: the first one, or else the last."""
    runs, k = [], 0
    while k < len(words):
        end = k
        while end < len(words) and words[end].kind not in ("name", "number"):
            end += 1
        if end > k:
            runs.append((k, end))
        k = max(end, k + 1)
    quantity = [r for r in runs if any(w.kind == "quantity" for w in words[slice(*r)])]
    commanded = [
        r for r in runs if any(w.kind == "commanded" for w in words[slice(*r)])
    ]
    good = quantity or commanded
    return good[0] if good[0][0] == 0 else good[-1]


def _channel_of(words: list[_Word]) -> tuple[str, str]:
    quantities = {w.channel for w in words if w.kind == "quantity"}
    kinds = {w.kind for w in words}
    if "other" in kinds:
        return "", "not a measured or commanded channel of a joint"
    if len(quantities) > 1:
        return "", f"stands for {' and '.join(sorted(quantities))}"
    commanded = "commanded" in kinds
    if quantities:
        (channel,) = quantities
        if not commanded:
            return channel, ""
        if channel == "q":
            return "command", ""
        return "", f"commanded, not measured ({channel})"
    return ("command", "") if commanded else ("", "")


def _words(text: str) -> list[_Word]:
    found: list[_Word] = []
    for match in _TOKEN.finditer(text):
        token, start, end = match.group().lower(), match.start(), match.end()
        if token == "j" and found and text[found[-1].start : found[-1].end] in _TAU:
            found[-1] = replace(found[-1], end=end)
            continue
        kind, channel = "name", ""
        if token.isdigit():
            kind = "number"
        elif token in _QUANTITY:
            kind, channel = "quantity", _QUANTITY[token]
        elif token in _OTHER:
            kind = "other"
        elif token in _MEASURED:
            kind = "measured"
        elif token in _COMMANDED and (token != "d" or (found and found[-1].channel)):
            kind = "commanded"
        found.append(_Word(kind, channel, start, end))
    return found


def _unbracketed(text: str) -> str:
    return text[1:-1] if text[:1] == "[" and text[-1:] == "]" else text
