"""From terms to findings: effects grouped over joints, with what a reader needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Finding, Shrink, Value
from hybrid.diagnosis.answer.intervals import NORMAL, shrink
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.shapes import part_of_range
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.units import unit_at, units
from hybrid.effects import Effect, effect_class

_BYPRODUCT = 0.05  # of the largest change; joints below are merely touched
_OPEN = 0.8  # of a shape's range: an interval that wide says nothing of it
_PLACE = " It takes the place of the {} friction that the file declares."


@dataclass(frozen=True, eq=False)
class Beside:
    """What explains torque besides the terms of a search.

    Attributes:
        findings: Findings, with their shares of it.
        effects: The effects found, joint by joint.
        squares: What they explain at each joint, shape (n,), in units of noise.
    """

    findings: tuple[Finding, ...]
    effects: tuple[Effect, ...]
    squares: Array

    def joined(
        self, others: Sequence[Finding], explained: float
    ) -> tuple[Finding, ...]:
        """All findings with their shares of both, largest first.

        Args:
            others: Findings of the search.
            explained: What they explain, in units of noise.
        """
        own = float(self.squares.sum())
        part = own / max(own + explained, 1e-300)
        found = [replace(f, share=(1.0 - part) * f.share) for f in others]
        found += [replace(f, share=part * f.share) for f in self.findings]
        return tuple(sorted(found, key=lambda f: -f.share))


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
        own = [k for k in members if effects[k].id == effect_id]
        joints = {j for k in members for j in effects[k].at_joints}
        names = tuple(gap.robot.joints[j] for j in sorted(joints))
        gone = dict.fromkeys(effects[k].id for k in members if k not in own)
        parameters = [v for k in own for v in values(gap, effects[k])]
        for k in members[len(own) :]:
            parameters += [
                replace(v, name=f"{effects[k].id} {v.name}")
                for v in values(gap, effects[k])
            ]
        law, seen = effect_class(effect_id), scored.where_seen(members)
        finding = found_at(law, names, [a for k in own for a in kinds[k]], parameters)
        found.append(
            replace(
                finding,
                share=float(parts[members].sum()),
                shrink={"torque": fall(seen, seen.left(seen.without(*members)), rng)},
                sentence=finding.sentence + "".join(map(_PLACE.format, gone)),
            )
        )
    return tuple(sorted(found, key=lambda f: -f.share))


def found_at(
    law: type[Effect],
    joints: Sequence[str],
    alike: Sequence[str],
    parameters: Sequence[Value],
) -> Finding:
    """A finding in the words of its effect, of all that is explained.

    Args:
        law: The effect.
        joints: Names of the joints where it acts.
        alike: Ids that explain as much.
        parameters: What was fitted.
    """
    return Finding(
        effect=law.id,
        joints=tuple(joints),
        alternatives=tuple(dict.fromkeys((law.id, *alike))),
        share=1.0,
        parameters=tuple(parameters),
        shrink={},
        sentence=law.sentence.format(joints=listed(joints)),
        remedy=law.remedy,
    )


def fall(
    scored: Explanation, without: Sequence[Array], rng: np.random.Generator
) -> Shrink:
    """Torque gap as it is without something, and with all that was found.

    Both sides have the corrected background and all else that was found. Joints add up
    in units of N·m.

    Args:
        scored: What was found.
        without: Residual of each joint without it, [N·m].
        rng: Draws of the bootstrap.
    """
    joints, samples = acting(scored, without), len(scored.gap.fold)
    squares = [
        sum(np.bincount(scored.blocks(i), x[i] ** 2, samples) for i in joints)
        for x in (without, scored.after)
    ]
    count = sum(len(scored.after[i]) for i in joints)
    unit = units(scored.gap.robot, joints)[1]
    return shrink(np.array(squares), count, unit, rng)


def acting(scored: Explanation, without: Sequence[Array]) -> list[int]:
    """Joints where it matters that something is left out, not as a by-product.

    Args:
        scored: What was found.
        without: Residual of each joint without it, [N·m].
    """
    noise = scored.evidence.noise
    change = [x - y for x, y in zip(without, scored.after, strict=True)]
    size = np.array([x @ x for x in change]) / noise
    return np.flatnonzero(size >= _BYPRODUCT * size.max(initial=0.0)).tolist()


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
        low, high = value - NORMAL * std, value + NORMAL * std
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
