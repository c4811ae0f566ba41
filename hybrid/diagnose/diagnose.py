"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.diagnose.advise import advise
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.clocks import clocks_apart
from hybrid.diagnose.command import Link, command_link
from hybrid.diagnose.convention import Convention, find_convention
from hybrid.diagnose.diagnosis import Diagnosis, Finding, Verdict
from hybrid.diagnose.explanation import Explanation, explain, shares, split
from hybrid.diagnose.findings import alternatives, elsewhere, findings
from hybrid.diagnose.gap import Gap, measure_gap
from hybrid.diagnose.grounds import another_arm, far_off, too_little, unlike
from hybrid.diagnose.links import joined
from hybrid.diagnose.locate import locate
from hybrid.diagnose.refit import refit
from hybrid.diagnose.replayed import replayed
from hybrid.diagnose.result import Result
from hybrid.diagnose.term import Term
from hybrid.diagnose.threads import one_thread
from hybrid.diagnose.thresholds import Thresholds, thresholds
from hybrid.diagnose.units import units
from hybrid.diagnose.unseen import (
    left_somewhere,
    left_unseen,
    negligible,
    useful_terms,
)
from hybrid.diagnose.verify import Account, account, check
from hybrid.diagnose.visited import not_excited
from hybrid.effects.delay import Delay
from hybrid.recording import Recording, unbroken
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion

Progress = Callable[[str], None]

_UNSURE = "{} does not surely shrink the gap on motions that no step has seen"
_ANYWHERE = (
    "{} at {} explains as much as {} at {}: these motions do not tell where it is, so "
    "that it is not named"
)
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
        recordings: Logs of the real arm: time, position and torque. One with holes
            counts as several.
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


@one_thread
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
    recordings = since_first(_without_holes(recordings))
    tell = progress or (lambda _: None)
    answer = partial(_examined, robot, recordings, cutoff, without, seed, tell)
    result = answer(clocks=Delay.id not in without)
    if result.late and far_off(result.search):
        # What swings along seems late; then nothing is a cause in the log as it is.
        prompt = answer(clocks=False)
        return result if prompt.diagnosis.findings else prompt
    return result


def _examined(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    cutoff: float | None,
    without: Sequence[str],
    seed: int,
    tell: Progress,
    *,
    clocks: bool,
) -> Result:
    """The same, of one clock, or of torque that all joints may be late by."""
    rng = np.random.default_rng(seed)
    limits = thresholds()
    tell("measuring the gap")
    logged, recordings, gap, as_logged = _measured(
        robot, recordings, cutoff, clocks=clocks
    )
    learn = split(gap)
    tell("trying every effect at every joint")
    # Torque that is late at every joint is no term: it is taken back already.
    late = [Delay.id] if logged.clocks else []
    search = Search(gap, learn, without=[*without, *late])
    doubts = [x for x in (too_little(gap), unlike(gap)) if x is not None]
    if not doubts:
        search.run()
    tell("asking what is left")
    found, kinds, reached = vetted(gap, search, limits)
    if strange := another_arm(gap, search.terms):
        doubts, search.terms = [strange], []
    foreign = bool(doubts)
    if torn := _torn(search):
        search.terms = [t for t in search.terms if t not in torn]
        found = account(gap, search, limits, reached)
        doubts += torn.values()
    tell("scoring on motions that no step has seen")
    useless = False
    while True:
        scored = explain(gap, search, learn)
        effects = refit(gap, search)
        own = [kinds[t] for t in search.terms]
        causes = findings(scored, effects, own, shares(search, rng), rng)
        useful = useful_terms(scored, found, rng)
        if len(useful) == len(search.terms):
            break
        useless |= not negligible(scored, useful)
        search.terms = useful
        found, more, _ = vetted(gap, search, limits, reached)
        kinds |= more
    doubts += [_UNSURE.format(f.effect) for f in causes if _unsure(f)]
    doubts += [_ONCE.format(f.effect) for f in causes if _once(f, scored)]
    if logged.clocks and not foreign:
        apart = clocks_apart(as_logged, scored, logged, rng)
        causes = apart.beside(causes)
        effects = (*effects, *apart.effects)
        found = replace(found, before=found.before + apart.squares)
    verdict, unexplained = _verdict(found, causes, limits, left_unseen(found, scored))
    if (left := left_somewhere(found, scored)) and verdict == "explained":
        verdict = "partly_explained"
    strained = None if torn else far_off(search)
    if strained:
        doubts.append(strained)
    if (useless or strained or left) and verdict == "no_gap":
        verdict, unexplained = "unexplained", 1.0  # there is something, unlike all laws
    if too_little(gap):
        verdict, unexplained = "not_excited", 1.0
    diagnosis = replace(
        _diagnosis(as_logged, search, found, causes, verdict, unexplained),
        warnings=(*gap.notes, *logged.notes, *doubts),
    )
    tell("finding where the gap lies")
    if verdict != "not_excited":
        where = locate(as_logged, np.array(diagnosis.noise_floor), rng)
        diagnosis = replace(diagnosis, where=where)
    link = Link()
    if verdict != "not_excited" and not foreign:
        tell("asking whether torque follows the command")
        distorted = {j for e in effects if e.reports for j in e.joints}
        link = command_link(gap, recordings, rng, without=without, distorted=distorted)
        diagnosis = joined(diagnosis, found, as_logged, link, rng)
    return Result(diagnosis, as_logged, search, scored, found, effects, link.effects)


def _measured(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    cutoff: float | None,
    *,
    clocks: bool,
) -> tuple[Convention, list[Recording | Motion], Gap, Gap]:
    """How logs were written, and they and their gap with that taken back.

    The last is the gap with the log taken at its word where torque in it is late.
    """
    gap = measure_gap(robot, recordings, cutoff=cutoff)
    logged = find_convention(gap, recordings, clocks=clocks)
    if not logged:
        return logged, list(recordings), gap, gap
    explicit = partial(logged.explicit, robot)
    shifted = [logged.in_step(x) for x in recordings]
    gap = measure_gap(robot, shifted, cutoff=cutoff, correct=explicit)
    as_logged = gap
    if logged.clocks:
        as_logged = measure_gap(robot, recordings, cutoff=gap.cutoff, correct=explicit)
    return logged, shifted, gap, as_logged


def since_first(
    recordings: Sequence[Recording | Motion],
) -> list[Recording | Motion]:
    """The same by a clock that starts with the first of them.

    Loggers count from anywhere; what warms up or happens once is told by this clock.
    """
    start = min((float(x.t[0]) for x in recordings), default=0.0)
    return [replace(x, t=x.t - start) for x in recordings]


def _without_holes(
    recordings: Sequence[Recording | Motion],
) -> list[Recording | Motion]:
    parts = [unbroken(x) if isinstance(x, Recording) else (x,) for x in recordings]
    return [x for several in parts for x in several]


def _unsure(finding: Finding) -> bool:
    return finding.shrink["torque"].interval[0] < 0


def _once(finding: Finding, scored: Explanation) -> bool:
    return scored.where_seen(scored.members(finding.effect)) is not scored


def vetted(
    gap: Gap, search: Search, limits: Thresholds, reached: Array | None = None
) -> tuple[Account, dict[Term, tuple[str, ...]], Array]:
    """Leave a search the terms that pass all checks beside each other.

    Args:
        gap: The gap.
        search: A search that has run.
        limits: What is worth a cause.
        reached: Squares that more terms left, shape (n,), in units of noise.

    Returns:
        What they explain and miss, what each cannot be told from, and the squares that
        all of them had left, shape (n,), in units of noise.
    """
    found = account(gap, search, limits, reached)
    reached = found.after if reached is None else reached
    kinds: dict[Term, tuple[str, ...]] = {}
    fewer = False
    while True:
        checks = {t: check(search, t, found, limits) for t in search.terms}
        failing = [t for t, x in checks.items() if not x.passes(limits)]
        kinds |= {
            t: alternatives(search, t, limits)
            for t in checks if t not in failing and t not in kinds
        }  # fmt: skip
        if not failing:
            if not (fewer and search.reform()):
                return found, kinds, reached
            fewer, found = False, account(gap, search, limits, reached)
            continue
        fewer = True
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


def _torn(search: Search) -> dict[Term, str]:
    """Terms for which something at another joint does as well, and a sentence."""
    found, joints = {}, search.gap.robot.joints
    for term in search.terms:
        if other := elsewhere(search, term):
            both = [(x.place[0], joints[x.place[1][-1]]) for x in (other, term)]
            found[term] = _ANYWHERE.format(*both[0], *both[1])
    return found


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
        units=tuple(units(gap.robot, [j])[1] for j in range(gap.robot.size)),
        not_excited=not_excited(gap),
    )
