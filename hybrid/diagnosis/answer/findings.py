"""Turn terms of an explanation into findings: effects grouped over joints."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.diagnosis import Finding, Interval, Shrink, Value, listed
from hybrid.diagnosis.answer.words import effect_words
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.shapes import part_of_range
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import FASTEST, Effect, effect_class
from hybrid.statistics import HALF_WIDTH, interval_above

_RESAMPLES = 400
_LEAST_CHANGE = 0.05  # of the largest change at a joint
_UNDETERMINED = 0.8  # width of an interval, over the range of its shape
_ABSOLUTE = "rad", "s", ""  # units of gains that have one bound on arms of all sizes
_IMPLAUSIBLE = "{} of {} at {} is more than is plausible: it may have another cause"
_REPLACES = " It takes the place of the {} friction that the file declares."


@dataclass(frozen=True, eq=False)
class ExtraFindings:
    """Findings that are not terms of the search."""

    findings: tuple[Finding, ...]  # their shares sum to 1
    effects: tuple[Effect, ...]  # the effects found, joint by joint
    squares: Array  # that they explain at each joint, shape (n,), in units of noise

    def merged(
        self, others: Sequence[Finding], explained: float
    ) -> tuple[Finding, ...]:
        """Merge by share with findings that explain some squares, in units of noise."""
        own = float(self.squares.sum())
        part = own / max(own + explained, 1e-300)
        found = [replace(f, share=(1.0 - part) * f.share) for f in others]
        found += [replace(f, share=part * f.share) for f in self.findings]
        return tuple(sorted(found, key=lambda f: -f.share))


def findings(
    scored: Explanation,
    effects: Sequence[Effect],
    kinds: Sequence[Mapping[str, float]],
    parts: Array,
    rng: np.random.Generator,
) -> tuple[Finding, ...]:
    """Group the terms of an explanation by effect; largest share first.

    Each term has its effect with final values; the kinds of effects that explain as
    much, with their probabilities, its own first, or none in place of an unknown law;
    and its share in what is explained, shape (terms,).
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
        own = [k for k in members if effects[k].id == effect_id]
        declared = [k for k in members if k not in own]  # in the file, and replaced
        members = own + declared
        joints = {j for k in members for j in effects[k].at_joints}
        parameters = [v for k in own for v in fitted_values(gap, effects[k])]
        for k in declared:
            values = fitted_values(gap, effects[k])
            parameters += [replace(v, name=f"{effects[k].id} {v.name}") for v in values]
        seen = scored.where_seen(members)
        without = seen.left(seen.without(*members))
        finding = finding_of(
            effect_class(effect_id),
            [gap.robot.joints[j] for j in sorted(joints)],
            [a for k in own for a in kinds[k]],
            parameters,
            share=float(parts[members].sum()),
            shrink=torque_shrink(seen, without, rng),
        )
        each = [kinds[k] for k in own if kinds[k]]
        known = [sum(x.values()) for x in each]
        chances = [sum(x.get(a, 0.0) for x in each) for a in finding.alternatives]
        replaced = dict.fromkeys(effects[k].id for k in declared)
        sentence = finding.sentence + "".join(map(_REPLACES.format, replaced))
        finding = replace(
            finding,
            sentence=sentence,
            chances=tuple(x / max(len(each), 1) for x in chances),
            probability=float(np.mean(known)) if known else np.nan,
        )
        found.append(finding)
    return tuple(sorted(found, key=lambda f: -f.share))


def implausible(found: Sequence[Finding]) -> list[str]:
    """Doubts about findings with an angle, a time or a ratio beyond its bounds."""
    doubts = []
    for f in found:
        gains = {g.name: g for g in effect_class(f.effect).gains if g.unit in _ABSOLUTE}
        each = [(p, gains[p.name]) for p in f.parameters if p.name in gains]
        far = [p for p, g in each if not g.lower <= p.value <= g.upper]
        if far:
            most = max(far, key=lambda p: abs(p.value))
            size = f"{most.value:.2g} {most.unit}".strip()
            doubts.append(_IMPLAUSIBLE.format(effect_words(f.effect), size, most.joint))
    return doubts


def finding_of(
    law: type[Effect],
    joints: Sequence[str],
    alternatives: Sequence[str],
    parameters: Sequence[Value],
    *,
    share: float = 1.0,
    shrink: Shrink | None = None,
) -> Finding:
    """Make a finding with sentence and remedy of its effect."""
    return Finding(
        effect=law.id,
        joints=tuple(joints),
        alternatives=tuple(dict.fromkeys((law.id, *alternatives))),
        share=share,
        parameters=tuple(parameters),
        shrink={"torque": shrink} if shrink else {},
        sentence=law.sentence.format(joints=listed(joints)),
        remedy=law.remedy,
    )


def torque_shrink(
    scored: Explanation, without: Sequence[Array], rng: np.random.Generator
) -> Shrink:
    """Compare the torque gap without a finding and with it, at the joints it changes.

    Both have the corrected background and all other findings; ``without`` is the
    residual of each joint without the finding, [N·m].
    """
    joints, samples = changed_joints(scored, without), len(scored.gap.fold)
    squares = [
        sum(np.bincount(scored.blocks(i), x[i] ** 2, samples) for i in joints)
        for x in (without, scored.after)
    ]
    count = sum(len(scored.after[i]) for i in joints)
    unit = scored.gap.robot.chain.unit_at(joints, "N·m")
    return shrunk(np.array(squares), count, unit, rng)


def changed_joints(scored: Explanation, without: Sequence[Array]) -> list[int]:
    """Joints whose residual depends on a finding, from their residual without it."""
    noise = scored.evidence.noise
    change = [x - y for x, y in zip(without, scored.after, strict=True)]
    size = np.array([x @ x for x in change]) / noise
    return np.flatnonzero(size >= _LEAST_CHANGE * size.max(initial=0.0)).tolist()


def fitted_values(gap: Gap, effect: Effect) -> list[Value]:
    """The parameters of an effect with their 95 % intervals, within their bounds."""
    scale, known = gap.scales[effect.joints[-1]], candidate(gap, effect)
    joint = "+".join(gap.robot.joints[j] for j in effect.at_joints)
    if effect.scope == "arm":
        joint = "arm"
    found = []
    for k, x in enumerate((*effect.gains, *effect.shapes_along(gap.motions))):
        if x.inner or x.name == FASTEST.name:
            continue
        value, std = effect.values[x.name], effect.std.get(x.name, 0.0)
        low, high = value - HALF_WIDTH * std, value + HALF_WIDTH * std
        # A search may widen the prior: what is told from zero is determined, too.
        told = abs(value) > HALF_WIDTH * std
        gain = k < len(effect.gains)
        determined = not gain or bool(std < known.std[k]) or told
        if std > 0 and gain:
            low, high = interval_above(known.lower[k], value, std)
        elif std > 0:
            bounds = x.scaled(scale)
            low, high = max(low, bounds.lower), min(high, bounds.upper)
            determined = part_of_range(bounds, low, high) < _UNDETERMINED
        unit = gap.robot.chain.unit_at(effect.unit_joints, x.unit)
        found.append(Value(joint, x.name, value, unit, (low, high), determined))
    return found


def interval(
    statistic: Callable[[Index], Array], blocks: int, rng: np.random.Generator
) -> Interval:
    """95 % interval of a share over blocks of time, as samples are correlated.

    ``statistic`` computes the share, shape (R,), from indices of the blocks in each
    resample, (R, blocks). The interval is 0 to 1 if there is a single block.
    """
    if blocks < 2:
        return 0.0, 1.0
    draws = statistic(rng.integers(blocks, size=(_RESAMPLES, blocks)))
    low, high = np.quantile(draws, [0.025, 0.975])
    return float(low), float(high)


def shrunk(squares: Array, count: int, unit: str, rng: np.random.Generator) -> Shrink:
    """RMS of a gap before and after, and the part removed with its interval.

    ``squares`` are sums over each block of time, before and after, shape (2, B), of
    ``count`` samples.
    """

    def removed(sums: Array) -> Array:
        before, after = sums
        whole = np.where(before > 0, before, np.inf)
        return np.asarray(1.0 - np.sqrt(after / whole))

    squares = squares[:, squares[0] > 0]
    whole = squares.sum(axis=1)
    before, after = np.sqrt(whole / max(count, 1)).tolist()
    return Shrink(
        before,
        after,
        float(removed(whole)) if before else 0.0,
        interval(lambda k: removed(squares[:, k].sum(axis=-1)), squares.shape[1], rng),
        unit=unit,
    )
