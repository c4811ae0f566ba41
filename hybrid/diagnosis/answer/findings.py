"""From terms to findings: effects grouped over joints, with what a reader needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Finding, Shrink, Value
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.shapes import part_of_range
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.units import unit_at, units
from hybrid.effects import Effect

_RESAMPLES = 400
_NORMAL = 1.96
_OPEN = 0.8  # of a shape's range: an interval that wide says nothing of it
_PLACE = " It takes the place of the {} friction that the file declares."


def findings(
    scored: Explanation,
    effects: Sequence[Effect],
    kinds: Sequence[tuple[str, ...]],
    parts: Array,
    rng: np.random.Generator,
) -> tuple[Finding, ...]:
    """Findings by effect, largest share first.

    Args:
        scored: Terms on samples that no step has seen.
        effects: The same terms as effects with their final values.
        kinds: Ids that each term cannot be told from, itself first; none of a term that
            stands in for something unknown.
        parts: Share of each term in what is explained.
        rng: Draws of the bootstrap.
    """
    gap = scored.gap
    grouped: dict[str, list[int]] = {}
    for k in sorted(range(len(effects)), key=lambda k: effects[k].at_joints):
        grouped.setdefault(scored.named[k], []).append(k)
    found = []
    for effect_id, members in grouped.items():
        members = [k for k in members if kinds[k] or effects[k].id != effect_id]
        if not any(kinds[k] for k in members):
            continue
        # What the file declares, and this takes the place of, comes last.
        members.sort(key=lambda k: effects[k].id != effect_id)
        cls = effects[members[0]]
        joints = tuple(dict.fromkeys(j for k in members for j in effects[k].at_joints))
        names = tuple(gap.robot.joints[j] for j in sorted(joints))
        alike = [a for k in members if effects[k].id == effect_id for a in kinds[k]]
        gone = dict.fromkeys(x for k in members if (x := effects[k].id) != effect_id)
        found.append(
            Finding(
                effect=effect_id,
                joints=names,
                alternatives=tuple(dict.fromkeys((effect_id, *alike))),
                share=float(parts[members].sum()),
                parameters=tuple(
                    v
                    if effects[k].id == effect_id
                    else replace(v, name=f"{effects[k].id} {v.name}")
                    for k in members
                    for v in values(gap, effects[k])
                ),
                shrink={
                    "torque": torque_shrink(scored.where_seen(members), members, rng)
                },
                sentence=cls.sentence.format(joints=listed(names))
                + "".join(_PLACE.format(x) for x in gone),
                remedy=cls.remedy,
            )
        )
    return tuple(sorted(found, key=lambda f: -f.share))


def torque_shrink(
    scored: Explanation, members: Sequence[int], rng: np.random.Generator
) -> Shrink:
    """Torque gap with everything but some terms, and with them, where they act.

    Both sides have the corrected background and the other terms, so that the fall is
    due to these terms. Joints add up in units of N·m.
    """
    return fall(scored, scored.left(scored.without(*members)), rng)


def fall(
    scored: Explanation, without: Sequence[Array], rng: np.random.Generator
) -> Shrink:
    """Torque gap as it is without something, and with all that was found.

    Args:
        scored: What was found.
        without: Residual of each joint without it, [N·m].
        rng: Draws of the bootstrap.
    """
    joints = [
        i
        for i, (x, y) in enumerate(zip(without, scored.after, strict=True))
        if len(x) and np.abs(x - y).max() > 0
    ]
    main = _main_joints(without, scored.after, scored.evidence.noise, joints)
    before, after = (
        _block_squares(scored, without, main),
        _block_squares(scored, scored.after, main),
    )
    count = sum(len(scored.after[i]) for i in main)
    removed = _removed(before.sum(), after.sum())
    draws = []
    for _ in range(_RESAMPLES):
        pick = rng.integers(len(before), size=len(before))
        draws.append(_removed(before[pick].sum(), after[pick].sum()))
    low, high = np.quantile(draws, [0.025, 0.975]) if len(before) > 1 else (0.0, 1.0)
    return Shrink(
        float(np.sqrt(before.sum() / max(count, 1))),
        float(np.sqrt(after.sum() / max(count, 1))),
        removed,
        (float(low), float(high)),
        unit=units(scored.gap.robot, main)[1],
    )


def _main_joints(
    without: Sequence[Array], after: Sequence[Array], noise: Array, joints: list[int]
) -> list[int]:
    """Joints where the fall is not a mere by-product."""
    fall = {
        i: (without[i] @ without[i] - after[i] @ after[i]) / noise[i] for i in joints
    }
    most = max(fall.values(), default=0.0)
    return [i for i in joints if fall[i] > 0.05 * most] or joints


def _block_squares(
    scored: Explanation, left: Sequence[Array], joints: Sequence[int]
) -> Array:
    total = np.zeros(1)
    for i in joints:
        blocks = scored.blocks(i)
        squares = np.bincount(blocks, weights=left[i] ** 2)
        size = max(len(total), len(squares))
        total = np.pad(total, (0, size - len(total)))
        total += np.pad(squares, (0, size - len(squares)))
    return np.asarray(total[total > 0]) if np.any(total > 0) else total


def _removed(before: float, after: float) -> float:
    return float(1.0 - np.sqrt(after / before)) if before > 0 else 0.0


def values(gap: Gap, effect: Effect) -> list[Value]:
    """The parameters of an effect with their 95 % intervals.

    Of a shape that the recordings do not tell, all of its range.
    """
    scale, prior = gap.scales[effect.joints[-1]], candidate(gap, effect).std
    joint = "+".join(gap.robot.joints[j] for j in effect.at_joints)
    if effect.scope == "arm":
        joint = "arm"
    values = []
    for k, x in enumerate((*effect.gains, *effect.shapes)):
        if x.inner:
            continue
        value, std = effect.values[x.name], effect.std.get(x.name, 0.0)
        low, high = value - _NORMAL * std, value + _NORMAL * std
        determined = k >= len(prior) or bool(std < prior[k])
        if std > 0 and x in effect.shapes:
            bounds = x.scaled(scale)
            low, high = max(low, bounds.lower), min(high, bounds.upper)
            determined = part_of_range(bounds, low, high) < _OPEN
        unit = x.unit
        if effect.scope != "arm":
            unit = unit_at(gap.robot, effect.at_joints, unit)
        values.append(Value(joint, x.name, value, unit, (low, high), determined))
    return values


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
