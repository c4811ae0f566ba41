"""Names and numbers of joints in a file -> joints of the robot."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_COUNTED = re.compile(r"(?:joints?|axis|ax|j|a|motor)?[\W_]*(\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class MatchedJoints:
    """Joints of the robot for joints of a file.

    Attributes:
        joints: The robot's name of each, or the file's where the robot has none.
        missing: The robot's joints that the file does not have.
    """

    joints: tuple[str, ...]
    missing: tuple[str, ...]


def match_joints(
    names: Sequence[str], numbers: Sequence[int | None], joints: tuple[str, ...]
) -> MatchedJoints:
    """Find the robot's joint for each joint of a file.

    By name: as written, or without case, separators and the word joint, or without a
    prefix that all have. Numbers, and names that only count (``joint1``), are taken in
    order, from 1 or from 0.

    Args:
        names: Joints as the file writes them.
        numbers: Their numbers, None where it names them.
        joints: Joint names of the robot, base to tip.
    """
    if all(number is None for number in numbers):
        found = _by_name(names, joints)
        counted = [m for name in names if (m := _COUNTED.fullmatch(name))]
        if set(found.values()) == set(joints) or len(counted) < len(names):
            return _matched([found.get(name, name) for name in names], joints)
        numbers = [int(m.group(1)) for m in counted]
    first = min((n for n in numbers if n is not None), default=1)
    start = min(first, 1)
    result = []
    for name, number in zip(names, numbers, strict=True):
        place = -1 if number is None else number - start
        if str(number) in joints:
            result.append(str(number))
        elif 0 <= place < len(joints):
            result.append(joints[place])
        elif number is None:
            result.append(_by_name([name], joints).get(name, name))
        else:
            result.append(f"number {number}")
    return _matched(result, joints)


def _matched(found: list[str], joints: tuple[str, ...]) -> MatchedJoints:
    missing = tuple(joint for joint in joints if joint not in found)
    return MatchedJoints(tuple(found), missing)


def _by_name(names: Sequence[str], joints: tuple[str, ...]) -> dict[str, str]:
    """The robot's joint for each name that has one, under the strictest spelling."""
    unique = tuple(dict.fromkeys(names))
    best: dict[str, str] = {}
    prefix = _prefix(joints)
    spellings: tuple[tuple[Callable[[str], str], Callable[[str], str]], ...] = (
        (str, str),
        (str.lower, str.lower),
        (_bare, _bare),
        (_bare, lambda joint: _bare(joint[len(prefix) :])),
        (lambda name: _bare(name[len(_prefix(unique)) :]), _bare),
        (
            lambda name: _bare(name[len(_prefix(unique)) :]),
            lambda joint: _bare(joint[len(prefix) :]),
        ),
    )
    for of_name, of_joint in spellings:
        spelled: dict[str, list[str]] = {}
        for joint in joints:
            spelled.setdefault(of_joint(joint), []).append(joint)
        found = {n: spelled.get(of_name(n), []) for n in unique}
        sure = {n: where[0] for n, where in found.items() if len(where) == 1}
        if len(sure) > len(best) and len(set(sure.values())) == len(sure):
            best = sure
    if len(best) < len(joints):  # arms among others: left_elbow_joint of elbow_joint
        ends = {j: [n for n in unique if _ends(n, j[len(prefix) :])] for j in joints}
        sure = {where[0]: j for j, where in ends.items() if len(where) == 1}
        if len(sure) == len(joints):
            best = sure
    return best


def _ends(name: str, joint: str) -> bool:
    return re.search(rf"(^|[\W_]){re.escape(joint.lower())}$", name.lower()) is not None


def _bare(name: str) -> str:
    plain = re.sub(r"[\W_]", "", name.lower())
    return plain.removesuffix("joint") or plain


def _prefix(names: Sequence[str]) -> str:
    """What all names begin with, up to a separator."""
    if len(names) < 2:
        return ""
    common = os.path.commonprefix(list(names))
    ends = [m.end() for m in re.finditer(r"[_/.]", common)]
    return common[: ends[-1]] if ends else ""
