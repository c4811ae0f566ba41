"""Match the names and numbers of joints in a file to the joints of the robot."""

import os
import re
from collections.abc import Sequence

_COUNTED = re.compile(r"(?:joints?|axis|ax|j|a|motor)?[\W_]*(\d+)", re.IGNORECASE)


def match_joints(
    names: Sequence[str], numbers: Sequence[int | None], joints: tuple[str, ...]
) -> tuple[str, ...]:
    """Find the robot's joint for each joint of a file.

    Names match as written, or without case, separators and the word joint, or without
    a prefix that all names have. Numbers, and names that only count (``joint1``), are
    taken in order, from 1 or from 0.

    Args:
        names: Joints as the file writes them.
        numbers: Joint numbers, None for a joint with a name.
        joints: Joint names of the robot, base to tip.

    Returns:
        The robot's name of each joint, or the file's name if the robot has none.
    """
    if all(number is None for number in numbers):
        found = _by_name(names, joints)
        counted = [m for name in names if (m := _COUNTED.fullmatch(name))]
        if set(found.values()) == set(joints) or len(counted) < len(names):
            return tuple(found.get(name, name) for name in names)
        numbers = [int(m.group(1)) for m in counted]
    start = 0 if 0 in numbers else 1
    result = []
    for name, number in zip(names, numbers, strict=True):
        if number is None:
            result.append(_by_name([name], joints).get(name, name))
        elif str(number) in joints:
            result.append(str(number))
        elif 0 <= number - start < len(joints):
            result.append(joints[number - start])
        else:
            result.append(f"number {number}")
    return tuple(result)


def _by_name(names: Sequence[str], joints: tuple[str, ...]) -> dict[str, str]:
    """Robot's joint for each name that has one; exact spelling is preferred."""
    unique = tuple(dict.fromkeys(names))
    skip_joint, skip_name = len(_prefix(joints)), len(_prefix(unique))
    spellings = (  # and characters that are skipped of the name, and of the joint
        (str, 0, 0),
        (str.lower, 0, 0),
        (_bare, 0, 0),
        (_bare, 0, skip_joint),
        (_bare, skip_name, 0),
        (_bare, skip_name, skip_joint),
    )
    best: dict[str, str] = {}
    for spell, of_name, of_joint in spellings:
        spelled: dict[str, list[str]] = {}
        for joint in joints:
            spelled.setdefault(spell(joint[of_joint:]), []).append(joint)
        found = {n: spelled.get(spell(n[of_name:]), []) for n in unique}
        matched = {n: where[0] for n, where in found.items() if len(where) == 1}
        if len(matched) > len(best) and len(set(matched.values())) == len(matched):
            best = matched
    if len(best) < len(joints):  # one of several arms: left_elbow_joint, elbow_joint
        endings = {j: rf"(^|[\W_]){re.escape(j[skip_joint:].lower())}$" for j in joints}
        ends = {j: [n for n in unique if re.search(endings[j], n.lower())]
                for j in joints}  # fmt: skip
        matched = {where[0]: j for j, where in ends.items() if len(where) == 1}
        if len(matched) == len(joints):
            best = matched
    return best


def _bare(name: str) -> str:
    plain = re.sub(r"[\W_]", "", name.lower())
    return plain.removesuffix("joint") or plain


def _prefix(names: Sequence[str]) -> str:
    """Common beginning of all names, up to a separator."""
    if len(names) < 2:
        return ""
    common = os.path.commonprefix(list(names))
    return common[: max(map(common.rfind, "_/.")) + 1]
