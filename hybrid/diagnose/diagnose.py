"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.diagnose.advise import advise
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.command import Link, command_link
from hybrid.diagnose.convention import find_convention
from hybrid.diagnose.diagnosis import Diagnosis, Finding, Verdict
from hybrid.diagnose.explanation import Explanation, explain, shares, split
from hybrid.diagnose.findings import alternatives, findings, torque_shrink
from hybrid.diagnose.gap import Gap, measure_gap
from hybrid.diagnose.grounds import another_arm, too_little, unlike
from hybrid.diagnose.links import joined
from hybrid.diagnose.locate import locate
from hybrid.diagnose.refit import refit
from hybrid.diagnose.replayed import replayed
from hybrid.diagnose.result import Result
from hybrid.diagnose.term import Term
from hybrid.diagnose.thresholds import Thresholds, thresholds
from hybrid.diagnose.verify import Account, account, check
from hybrid.diagnose.visited import not_excited
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion

Progress = Callable[[str], None]

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
_HALF = 0.5  # of the gap on unseen motions, with a term that does not act there
_UNSURE = "{} does not surely shrink the gap on motions that no step has seen"
_ONCE = (
    "{} acts only in what was learnt from: its shrinkage is on the same samples, not "
    "on motions that no step has seen"
)


def diagnose(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a sim-to-real gap lies, what causes it, and how far it shrinks.

    Args:
        robot: The simulator as it stands today.
        recordings: Logs of the real arm: time, position and torque.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
        without: Ids of effects to leave out of the library.
        seed: Seed of the bootstrap.
        progress: Called with what is being done.

    Raises:
        IdentificationError: There is no recording.
        RecordingError: A recording does not fit the arm.
    """
    rng = np.random.default_rng(seed)
    result = examine(
        robot,
        recordings,
        cutoff=cutoff,
        without=without,
        seed=seed,
        progress=progress,
    )
    result = replayed(result, rng, progress=progress)
    return replace(result.diagnosis, advice=advise(result, rng))


def examine(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Result:
    """:func:`diagnose` in torque, with everything that led to the answer."""
    tell = progress or (lambda _: None)
    rng = np.random.default_rng(seed)
    limits = thresholds()
    recordings = since_first(recordings)
    tell("measuring the gap")
    gap = measure_gap(robot, recordings, cutoff=cutoff)
    logged = find_convention(gap, recordings)
    if logged:
        recordings = [logged.in_step(x) for x in recordings]
        explicit = partial(logged.explicit, robot)
        gap = measure_gap(robot, recordings, cutoff=cutoff, correct=explicit)
    learn = split(gap)
    tell("trying every effect at every joint")
    search = Search(gap, learn, without=without)
    doubts = [x for x in (too_little(gap), unlike(gap)) if x is not None]
    if not doubts:
        search.run()
    tell("asking what is left")
    found, kinds, reached = vetted(gap, search, limits)
    if strange := another_arm(gap, search.terms):
        doubts, search.terms = [strange], []
    foreign = bool(doubts)
    tell("scoring on motions that no step has seen")
    useless = False
    while True:
        scored = explain(gap, search, learn)
        effects = refit(gap, search)
        own = [kinds[t] for t in search.terms]
        causes = findings(scored, effects, own, shares(search, rng), rng)
        useful = _useful(scored, found, rng)
        if len(useful) == len(search.terms):
            break
        useless |= not _negligible(scored, useful)
        search.terms = useful
        found = account(gap, search, limits, reached)
    doubts += [_UNSURE.format(f.effect) for f in causes if _unsure(f)]
    doubts += [_ONCE.format(f.effect) for f in causes if _once(f, scored)]
    verdict, unexplained = _verdict(found, causes, limits, _left_unseen(found, scored))
    if useless and verdict == "no_gap":
        verdict, unexplained = "unexplained", 1.0  # there is something, unlike all laws
    if too_little(gap):
        verdict, unexplained = "not_excited", 1.0
    diagnosis = replace(
        _diagnosis(gap, search, found, causes, verdict, unexplained),
        warnings=(*gap.notes, *logged.notes, *doubts),
    )
    tell("finding where the gap lies")
    if verdict != "not_excited":
        where = locate(gap, np.array(diagnosis.noise_floor), rng)
        diagnosis = replace(diagnosis, where=where)
    link = Link()
    if verdict != "not_excited" and not foreign:
        tell("asking whether torque follows the command")
        reported = [t.place[1] for t in search.terms if t.candidate.effect.reports]
        distorted = {j for joints in reported for j in joints}
        link = command_link(gap, recordings, rng, without=without, distorted=distorted)
        diagnosis = joined(diagnosis, found, gap, link, rng)
    return Result(diagnosis, gap, search, scored, found, effects, link.effects)


def since_first(
    recordings: Sequence[Recording | Motion],
) -> list[Recording | Motion]:
    """The same by a clock that starts with the first of them.

    Loggers count from anywhere; what warms up or happens once is told by this clock.
    """
    start = min((float(x.t[0]) for x in recordings), default=0.0)
    return [replace(x, t=x.t - start) for x in recordings]


def _useful(
    scored: Explanation, found: Account, rng: np.random.Generator
) -> list[Term]:
    """Terms whose effect, and whose joint, leaves less of the gap on unseen motions.

    Two effects of one joint may each seem to help, and only undo one another. Of what
    is large where it was learnt, few unseen seconds prove nothing unless they are sure.
    What happened only once is no cause where the gap is there without it.
    """
    useless: set[int] = set()
    joints = range(scored.gap.robot.size)
    blocks = np.unique(np.concatenate([scored.blocks(i) for i in joints]))
    enough = len(blocks) >= _FEWEST_BLOCKS
    for kind in range(2):  # effect, joints
        groups: dict[object, list[int]] = {}
        for k, term in enumerate(scored.terms):
            groups.setdefault(term.place[kind], []).append(k)
        for members in groups.values():
            rest = [t for k, t in enumerate(scored.terms) if k not in members]
            if scored.where_seen(members) is not scored:
                if _left_unseen(found, scored, _where(scored, members)) > _HALF:
                    useless |= {*members}
                continue
            shrink = torque_shrink(scored, members, rng)
            if not enough and _large(scored.learnt, members, rng):
                if shrink.interval[1] <= 0:
                    useless |= {*members}
                continue
            lost = shrink.removed <= _LEAST_REMOVED * kind
            doubtful = enough and shrink.interval[0] < -_DOUBT * shrink.removed
            rough = any(scored.terms[k].candidate.effect.steep for k in members)
            least = _LEAST_ROUGH if rough else _LEAST_KEPT
            lost |= doubtful and _vanished(*scored.kept(members), least)
            if lost or _negligible(scored, rest):
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


def _large(
    learnt: Explanation | None, members: Sequence[int], rng: np.random.Generator
) -> bool:
    """Whether some terms remove much of the gap where they were learnt."""
    return learnt is not None and torque_shrink(learnt, members, rng).removed > _MUCH


def _negligible(scored: Explanation, kept: list[Term]) -> bool:
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


def _unsure(finding: Finding) -> bool:
    return finding.shrink["torque"].interval[0] < 0


def _once(finding: Finding, scored: Explanation) -> bool:
    return scored.where_seen(scored.members(finding.effect)) is not scored


def vetted(
    gap: Gap, search: Search, limits: Thresholds
) -> tuple[Account, dict[Term, tuple[str, ...]], Array]:
    """Leave a search the terms that pass all checks beside each other.

    Returns:
        What they explain and miss, what each cannot be told from, and the squares that
        all of them had left, shape (n,), in units of noise.
    """
    found = account(gap, search, limits)
    reached = found.after
    kinds: dict[Term, tuple[str, ...]] = {}
    while True:
        checks = {t: check(search, t, found, limits) for t in search.terms}
        failing = [t for t, x in checks.items() if not x.passes(limits)]
        kinds |= {
            t: alternatives(search, t, limits)
            for t in checks if t not in failing and t not in kinds
        }  # fmt: skip
        if not failing:
            return found, kinds, reached
        # One after the other: what is left fits anew, and may well pass then.
        out = min(failing, key=search.loss)
        recur = checks[out].recurs
        search.terms = [
            t for t in search.terms
            if t is not out and not (recur and checks[t].recurs)
        ]  # fmt: skip
        search.prune()
        without = account(gap, search, limits, reached)
        if checks[out].echo and checks[out].sound(limits):
            # What noise looks like is not missed.
            reached = reached + without.after - found.after
            without = account(gap, search, limits, reached)
        found = without


def _left_unseen(
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


def _verdict(
    found: Account, effects: Sequence[Finding], limits: Thresholds, left: float
) -> tuple[Verdict, float]:
    """What it comes to, and the unexplained share of the explainable gap."""
    explained, missed = found.explained.sum(), found.missed.sum()
    share = float(missed / (explained + missed)) if explained + missed > 0 else 0.0
    if not effects:
        return ("unexplained", 1.0) if missed > 0 else ("no_gap", 0.0)
    share = max(share, left)
    if 1.0 - share >= limits.explained:
        return "explained", share
    return "partly_explained", share


def _diagnosis(
    gap: Gap,
    search: Search,
    found: Account,
    effects: Sequence[Finding],
    verdict: Verdict,
    unexplained: float,
) -> Diagnosis:
    rows = search.evidence.rows
    count = np.array([max(len(r), 1) for r in rows])
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    moving = np.maximum(gap.moving.sum(axis=0), 1)
    rms = np.sqrt(squares.sum(axis=0) / moving)
    size = np.sqrt((np.where(gap.moving, gap.measured, 0.0) ** 2).sum(axis=0) / moving)
    floor = np.sqrt(np.maximum(found.noise, 0.0) * search.evidence.noise / count)
    return Diagnosis(
        robot=gap.robot.name,
        joints=gap.robot.joints,
        rms=tuple(map(float, rms)),
        relative=tuple(map(float, rms / np.where(size > 0, size, np.inf))),
        noise_floor=tuple(map(float, floor)),
        where=(),
        findings=tuple(effects),
        verdict=verdict,
        unexplained=unexplained,
        background=search.off,
        not_excited=not_excited(gap),
    )
