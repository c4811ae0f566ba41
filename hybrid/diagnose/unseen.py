"""What terms are worth on motions that no step has seen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hybrid.diagnose.account import Account
from hybrid.diagnose.explanation import Explanation
from hybrid.diagnose.findings import torque_shrink
from hybrid.diagnose.term import Term
from hybrid.effects.contact import Contact

_SMALLEST = 0.001  # of the measured torque, RMS
_LEAST_GAP = 0.002  # the same: two solvers differ by as much
_LEAST_REMOVED = 0.01  # of a joint's gap by all its terms, on unseen motions
_DOUBT = 0.05  # of what a term removes: most that its interval says it may add
_BEYOND = 2.0  # times the squares of noise
_FEWEST_BLOCKS = 6  # of a second, for an interval that tells
_MUCH = 0.3  # of the gap's RMS, where a term was learnt
_LEAST_KEPT = 0.5  # of the fall that a term's torque promises: it is 3/4 of its size
_LEAST_ROUGH = 0.0  # the same of a law that holds roughly: as likely as nothing
_SURE = 2.0  # standard deviations
_MAIN = 0.2  # of a term's squares at its main joint
_MOST_LEFT = 0.8  # of the gap on unseen motions, where a term acts
_LARGE = 0.1  # of a joint's torque, RMS: a gap that an explanation has to explain
_MOST_LEFT_ONCE = 0.5  # the same if it does not act in these motions
_AS_LARGE = 0.1  # mean squares left there over those of what a term does
_AT_ONCE = 0.95  # of a term's squares, within one second


def useful_terms(
    scored: Explanation, found: Account, rng: np.random.Generator
) -> list[Term]:
    """Terms whose effect, and whose joint, leaves less of the gap on unseen motions.

    Two effects of one joint may each seem to help, and only undo one another. Of what
    is large where it was learnt, few unseen seconds prove nothing unless they are sure.
    Nor is a cause what leaves nearly all of the gap on such motions where it acts, or
    what happened only once and the gap is there without it; or what happened only once
    and at once, unless it is of such a kind: one event fits any law.

    Args:
        scored: The terms on motions that no step has seen.
        found: The account of the gap where they were learnt, squares in noise units.
        rng: Draws of the bootstrap.
    """
    useless: set[int] = set()
    size = scored.gap.robot.size
    blocks = np.unique(np.concatenate([scored.blocks(i) for i in range(size)]))
    enough = len(blocks) >= _FEWEST_BLOCKS
    for kind in range(2):  # effect, joints
        groups: dict[object, list[int]] = {}
        for k, term in enumerate(scored.terms):
            groups.setdefault(term.place[kind], []).append(k)
        for members in groups.values():
            rest = [t for k, t in enumerate(scored.terms) if k not in members]
            joints, seen = _where(scored, members), scored.where_seen(members)
            left = left_unseen(found, scored, joints)
            if seen is not scored:
                if left > _MOST_LEFT_ONCE and _as_large(scored, seen, members, joints):
                    useless |= {*members}
                useless |= {k for k in members if _is_event(seen, k)}
                continue
            shrink = torque_shrink(scored, members, rng)
            if not enough and _large(scored.learnt, members, rng):
                if shrink.interval[1] <= 0:
                    useless |= {*members}
                continue
            if left > _MOST_LEFT:
                useless |= {*members}
            lost = shrink.removed <= _LEAST_REMOVED * kind
            doubtful = enough and shrink.interval[0] < -_DOUBT * shrink.removed
            rough = any(scored.terms[k].candidate.effect.steep for k in members)
            least = _LEAST_ROUGH if rough else _LEAST_KEPT
            lost |= doubtful and _vanished(*scored.kept(members), least)
            if lost or negligible(scored, rest):
                useless |= {*members}
    return [t for k, t in enumerate(scored.terms) if k not in useless]


def _vanished(kept: float, deviation: float, least: float = _LEAST_KEPT) -> bool:
    """Whether a term does less than it promised, and no noise can be why."""
    return kept < min(least, 1.0 - _SURE * deviation)


def _where(scored: Explanation, members: Sequence[int]) -> list[int]:
    """Joints at which some terms act most, in units of noise, where they were seen."""
    seen, squares = scored.where_seen(members), np.zeros(scored.gap.robot.size)
    for k in members:
        squares += [float(x @ x) for x in seen.contribution(k)] / seen.evidence.noise
    return [i for i, x in enumerate(squares) if x > _MAIN * squares.max()]


def _is_event(seen: Explanation, k: int) -> bool:
    """Whether a term, which is not of such a kind, acts within one second only."""
    if seen.terms[k].place[0] == Contact.id:
        return False
    parts, noise = seen.contribution(k), seen.evidence.noise
    weights = np.concatenate([x**2 / s for x, s in zip(parts, noise, strict=True)])
    blocks = np.concatenate([seen.blocks(i) for i in range(len(parts))])
    squares = np.bincount(blocks, weights)
    return bool(squares.max(initial=0.0) > _AT_ONCE * squares.sum())


def _as_large(
    scored: Explanation, seen: Explanation, members: Sequence[int], joints: list[int]
) -> bool:
    """Whether about as much is left on unseen motions as some terms do where seen."""
    torque = [np.sum([seen.contribution(k)[i] for k in members], 0) for i in joints]
    left = [scored.after[i] for i in joints]
    sizes = [sum(np.mean(x**2) for x in parts if len(x)) for parts in (left, torque)]
    return bool(sizes[0] > _AS_LARGE * sizes[1])


def _large(
    learnt: Explanation | None, members: Sequence[int], rng: np.random.Generator
) -> bool:
    """Whether some terms remove much of the gap where they were learnt."""
    return learnt is not None and torque_shrink(learnt, members, rng).removed > _MUCH


def negligible(scored: Explanation, kept: list[Term]) -> bool:
    """Whether all terms that go are too small to matter beside the torque itself.

    Or the gap is, in which a term and a declared number may undo one another.
    """
    gap, left = scored.gap, [k for k, t in enumerate(scored.terms) if t not in kept]
    before = scored.left(scored.without(*left))
    for i, rows in enumerate(scored.evidence.rows):
        tau = gap.measured[rows, i]
        fall = before[i] @ before[i] - scored.after[i] @ scored.after[i]
        size = float(np.linalg.norm(tau))
        whole = float(scored.evidence.power[i].sum())
        if fall > (_SMALLEST * size) ** 2 and whole > (_LEAST_GAP * size) ** 2:
            return False
    return True


def left_unseen(
    found: Account, scored: Explanation, joints: Iterable[int] | None = None
) -> float:
    """Part of the gap on unseen motions that is left, where that is not noise.

    What is explained where it was learnt may not be explained elsewhere.

    Args:
        found: The account of the gap where it was learnt.
        scored: What explains it.
        joints: Those that count; all by default.
    """
    noise, seen = scored.evidence.noise, scored.learnt
    left = whole = 0.0
    for i in range(len(noise)) if joints is None else joints:
        after = scored.after[i]
        learnt = 0 if seen is None else len(seen.evidence.rows[i])
        if not len(after) or not learnt:
            continue
        usual = len(after) / learnt * found.noise[i]
        squares, before = after @ after / noise[i], scored.before[i] @ scored.before[i]
        left += squares - usual if squares > _BEYOND * usual else 0.0
        whole += max(before / noise[i] - usual, squares - usual, 0.0)
    return float(left / whole) if whole > 0 else 0.0


def left_somewhere(found: Account, scored: Explanation) -> bool:
    """Whether some joint keeps nearly all of a large gap on unseen motions.

    Args:
        found: The account of the gap where it was learnt.
        scored: What explains it.
    """
    for i, rows in enumerate(scored.evidence.rows):
        gap = np.linalg.norm(scored.before[i])
        large = gap > _LARGE * np.linalg.norm(scored.gap.measured[rows, i])
        if large and left_unseen(found, scored, [i]) > _MOST_LEFT:
            return True
    return False
