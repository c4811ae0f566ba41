"""Maps of columns to channels, from the user (``--map``) or from a preset."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping as MappingType
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid.errors import RecordingError
from hybrid.files import checked_table, read_yaml
from hybrid.recording.labels import split_unit
from hybrid.recording.recording import CHANNELS
from hybrid.recording.units import SI, converted

_FACTORS = ("torque_constant", "gear_ratio", "scale", "rate")
_KEYS = ("preset", "joints", "topic", "time", *CHANNELS)
Factor = float | tuple[float, ...] | dict[str, float]


@dataclass(frozen=True)
class Source:
    """Source of a channel.

    Attributes:
        columns: A pattern with ``{}`` for the joint's name or number, or labels by the
            joint's name or number from 1; None if the labels decide.
        unit: Unit of the columns, which overrules the file; empty if the file decides.
        factors: Factors by name: one number for all joints, a list in the order of the
            joints, or numbers by joint.
        dropped: Whether the channel is not read.
    """

    columns: str | dict[str, str] | None = None
    unit: str = ""
    factors: dict[str, Factor] = field(default_factory=dict)
    dropped: bool = False

    def over(self, below: Source) -> Source:
        """Complete this source from another."""
        columns = below.columns if self.columns is None else self.columns
        factors = below.factors | self.factors
        return Source(columns, self.unit or below.unit, factors, self.dropped)

    def found(self, labels: Sequence[str]) -> dict[int, str]:
        """Find the columns of the channel: joint by index of the column."""
        if isinstance(self.columns, dict):
            for label in self.columns.values():
                if label not in labels:
                    raise ValueError(f"no column {label!r}")
            return {labels.index(x): joint for joint, x in self.columns.items()}
        start, braces, end = (self.columns or "").partition("{}")
        found = {}
        for k, label in enumerate(labels):
            for text in (label, split_unit(label)[0]):
                joint = text[len(start) : len(text) - len(end)]
                if text == start + joint + end and bool(joint) == bool(braces):
                    found[k] = joint or "1"
        return found

    def factor(self, joints: Sequence[str], place: int) -> float:
        """Product of all factors for the joint at a place, from 0, among the joints."""
        product, joint = 1.0, joints[place]
        for name, value in self.factors.items():
            if isinstance(value, tuple):
                if len(value) != len(joints):
                    raise RecordingError(
                        f"the map gives {len(value)} numbers as {name} for "
                        f"{len(joints)} joints; valid is one for each of "
                        f"{', '.join(joints)}, in this order"
                    )
                value = dict(zip(joints, value, strict=True))
            if isinstance(value, dict) and joint not in value:
                raise RecordingError(
                    f"the map gives no {name} for {joint}; valid is a number, a list "
                    "in the order of the joints, or one for each joint by name"
                )
            product *= value[joint] if isinstance(value, dict) else value
        return product


@dataclass(frozen=True)
class Mapping:
    """Map of columns to channels, joints and units.

    Attributes:
        preset: Name of the preset that completes it; empty if none.
        joints: Names of numbered joints, in their order; empty if not given.
        names: Robot's joint name by the name in the file.
        topic: Beginning of the labels to read, such as a topic of a bag.
        sources: Sources of ``time`` and of channels.
        origin: File of the map, for messages.
    """

    preset: str = ""
    joints: tuple[str, ...] = ()
    names: dict[str, str] = field(default_factory=dict)
    topic: str = ""
    sources: dict[str, Source] = field(default_factory=dict)
    origin: str = "map"

    def source(self, channel: str) -> Source:
        """Source of a channel; an empty one if the map does not mention it."""
        return self.sources.get(channel, Source())


Map = str | Path | MappingType[str, Any] | Mapping | None


def read_mapping(given: Map) -> Mapping:
    """Read a map from a YAML file, a dict, or the name of a preset."""
    if given is None or isinstance(given, Mapping):
        return given or Mapping()
    if isinstance(given, MappingType):
        return _mapping(dict(given), "map")
    if str(given) in PRESETS:
        return _mapping({"preset": str(given)}, str(given))
    if Path(given).suffix.lower() not in (".yaml", ".yml"):
        raise RecordingError(
            f"{given}: no map; valid are a .yaml file and {', '.join(PRESETS)}"
        )
    return _mapping(read_yaml(given, RecordingError), str(given))


def preset_of(labels: tuple[str, ...], name: str = "") -> Mapping:
    """Preset of a name, or the one that fits the labels; an empty map if none."""
    for key, (shown, content) in PRESETS.items():
        fits = shown and all(
            any(re.fullmatch(x, label) for label in labels) for x in shown
        )
        if key == name or (fits and not name):
            return _mapping({"preset": key, **content}, key)
    return Mapping()


def _mapping(content: Any, origin: str) -> Mapping:
    content = checked_table(content, _KEYS, origin, RecordingError)
    preset, joints = str(content.get("preset", "")), content.get("joints", [])
    if preset and preset not in PRESETS:
        raise RecordingError(
            f"{origin}: unknown preset {preset!r}; valid are {', '.join(PRESETS)}"
        )
    named = isinstance(joints, dict)
    words = joints.values() if named else joints
    if (
        not isinstance(joints, (list, dict, tuple))
        or not all(isinstance(x, (str, int)) for x in words)
        or (not named and len({*map(str, words)}) < len(joints))
    ):
        raise RecordingError(
            f"{origin}: joints is {joints!r}; valid are a list of names in the order "
            "of the columns, each once, or file's name: robot's name"
        )
    return Mapping(
        preset,
        joints=() if named else tuple(map(str, joints)),
        names={str(k): str(joints[k]) for k in joints} if named else {},
        topic=str(content.get("topic", "")),
        sources={
            key: _source(content[key], key, f"{origin}: {key}")
            for key in ("time", *CHANNELS)
            if key in content
        },
        origin=origin,
    )


def _source(value: Any, channel: str, where: str) -> Source:
    if value is None or value is False or value == "none":
        return Source(dropped=True)
    if not isinstance(value, dict) or not (
        value.keys() <= {"columns", "column", "unit", *_FACTORS}
    ):
        return Source(columns=_columns(value, where))
    unit = str(value.get("unit", ""))
    kinds = (channel, "current") if channel == "tau" else (channel,)
    if unit and not any(converted(unit, kind) for kind in kinds):
        valid = " or ".join(x for kind in kinds for x in SI[kind])
        raise RecordingError(
            f"{where}: unit {unit!r} is none of {valid}; valid are units that convert "
            "to these, such as deg, rpm, ms, mA"
        )
    columns = value.get("columns", value.get("column"))
    factors = {k: _factor(value[k], f"{where}: {k}") for k in _FACTORS if k in value}
    rate = factors.get("rate", 1.0)
    if not isinstance(rate, float) or not rate > 0 or (
        "rate" in factors) != (channel == "time" and bool(factors)):  # fmt: skip
        raise RecordingError(
            f"{where} is {value!r}; valid is a rate above 0, in Hz, of time alone, "
            "which takes no other factor"
        )
    return Source(None if columns is None else _columns(columns, where), unit, factors)


def _columns(value: Any, where: str) -> str | dict[str, str]:
    if isinstance(value, str):
        return value
    if isinstance(value, (list, tuple)):
        value = {k + 1: label for k, label in enumerate(value)}
    if isinstance(value, dict) and all(isinstance(x, str) for x in value.values()):
        return {str(k): x for k, x in value.items()}
    raise RecordingError(
        f"{where} is {value!r}; valid are a label with {{}} for the joint, a list of "
        f"labels, joint: label, or columns with unit, {', '.join(_FACTORS)}"
    )


def _factor(value: Any, where: str) -> Factor:
    if isinstance(value, dict):
        return {str(k): _number(x, where) for k, x in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(_number(x, where) for x in value)
    return _number(value, where)


def _number(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise RecordingError(f"{where} is {value!r}; valid are numbers")
    return number


# Patterns of labels for which a preset applies by itself, and its content.
PRESETS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "ur_rtde": (
        ("timestamp", r"actual_q_?\d", r"target_q_?\d"),
        {"time": "timestamp", "q": "actual_q_{}", "v": "actual_qd_{}",
         "command": "target_q_{}",
         "tau": {"columns": "actual_current_{}", "unit": "A"},
         "temperature": {"columns": "joint_temperatures_{}", "unit": "degC"}}),
    "libfranka": (
        ("duration", r"(.*\W)?tau_J\[0\]"),
        {"time": {"column": "duration", "unit": "ms"}}),
    "libfranka_log": (
        ("time", r"state\.tau_J\[0\]"),
        {"time": {"column": "time", "unit": "ms"}, "q": "state.q[{}]",
         "v": "state.dq[{}]", "command": "state.q_d[{}]", "tau": "state.tau_J[{}]"}),
    "lerobot": (
        ("timestamp", r"observation\.state.*", "action.*"),
        {"time": "timestamp", "q": "observation.state[{}]", "command": "action[{}]"}),
    "joint_state": ((), {"q": {"unit": "rad"}, "v": {"unit": "rad/s"},
                         "tau": {"unit": "N*m"}}),
    "ur_driver": ((), {"q": {"unit": "rad"}, "v": {"unit": "rad/s"},
                       "tau": {"unit": "A"}}),
    "plotjuggler": (("__time",), {"time": {"column": "__time", "unit": "s"}}),
}  # fmt: skip
