"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.diagnose.account import Account, account
from hybrid.diagnose.advise import advise
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.clocks import clocks_apart
from hybrid.diagnose.command import Link, command_link
from hybrid.diagnose.diagnosis import Diagnosis, Finding, Verdict
from hybrid.diagnose.explanation import Explanation, split
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.grounds import (
    another_arm,
    far_off,
    overshadowed,
    too_little,
    unlike,
)
from hybrid.diagnose.links import joined
from hybrid.diagnose.locate import locate
from hybrid.diagnose.logs import measured, since_first
from hybrid.diagnose.replayed import replayed
from hybrid.diagnose.result import Result
from hybrid.diagnose.settled import settled, unsure
from hybrid.diagnose.thresholds import Thresholds, thresholds
from hybrid.diagnose.units import units
from hybrid.diagnose.unseen import left_somewhere, left_unseen
from hybrid.diagnose.vetted import torn, vetted
from hybrid.diagnose.visited import not_excited
from hybrid.effects.delay import Delay
from hybrid.identify.data import taken
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.threads import one_thread

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
    recordings = since_first(taken(robot, recordings))
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
    logged, recordings, gap, as_logged = measured(
        robot, recordings, cutoff, clocks=clocks
    )
    learn = split(gap)
    tell("trying every effect at every joint")
    # Torque that is late at every joint is no term: it is taken back already.
    late = [Delay.id] if logged.clocks else []
    search = Search(gap, learn, without=[*without, *late])
    grounds = too_little(gap), unlike(gap)
    doubts = [x for x in grounds if x is not None]
    if not doubts:
        search.run()
    tell("asking what is left")
    found, kinds, reached = vetted(gap, search, limits)
    if strange := another_arm(gap, search.terms):
        doubts, search.terms = [strange], []
    foreign = bool(doubts)
    if anywhere := torn(search):
        search.terms = [t for t in search.terms if t not in anywhere]
        found = account(gap, search, limits, reached)
        doubts += [
            _ANYWHERE.format(*search.placed(other), *search.placed(t))
            for t, other in anywhere.items()
        ]
    if small := overshadowed(search):
        search.terms = [t for t in search.terms if t not in small]
        found = account(gap, search, limits, reached)
    tell("scoring on motions that no step has seen")
    last = settled(search, learn, found, kinds, reached, rng)
    found, scored, odd = last.found, last.scored, last.odd
    effects, causes = last.effects, last.causes
    doubts += [_UNSURE.format(f.effect) for f in causes if unsure(f)]
    doubts += [_ONCE.format(f.effect) for f in causes if _once(f, scored)]
    if logged.clocks and not foreign:
        apart = clocks_apart(as_logged, scored, logged, rng)
        causes = apart.beside(causes)
        effects = (*effects, *apart.effects)
        found = replace(found, before=found.before + apart.squares)
    if not anywhere and (strained := far_off(search)):
        doubts.append(strained)
        odd = True
    verdict, unexplained = _verdict(
        found, scored, causes, limits, odd=odd, whole=not anywhere
    )
    diagnosis = replace(
        _diagnosis(as_logged, search, found, causes, verdict, unexplained),
        warnings=(*gap.notes, *logged.notes, *doubts),
    )
    link = Link()
    if verdict != "not_excited":
        tell("finding where the gap lies")
        where = locate(as_logged, np.array(diagnosis.noise_floor), rng)
        diagnosis = replace(diagnosis, where=where)
    if verdict != "not_excited" and not foreign:
        tell("asking whether torque follows the command")
        distorted = {j for e in effects if e.reports for j in e.joints}
        link = command_link(gap, recordings, rng, without=without, distorted=distorted)
        diagnosis = joined(diagnosis, found, as_logged, link, rng)
    return Result(
        diagnosis, as_logged, search, scored, found, effects, link.effects, anywhere
    )


def _once(finding: Finding, scored: Explanation) -> bool:
    return scored.where_seen(scored.members(finding.effect)) is not scored


def _verdict(
    found: Account,
    scored: Explanation,
    causes: Sequence[Finding],
    limits: Thresholds,
    *,
    odd: bool,
    whole: bool,
) -> tuple[Verdict, float]:
    """What it comes to, and the unexplained share of the explainable gap.

    Args:
        found: The account of the gap where the terms were learnt.
        scored: The terms on motions that no step has seen.
        causes: What is named.
        limits: What is worth a cause.
        odd: Whether something was seen there that is unlike all laws.
        whole: Whether all that explains it could be named.
    """
    if too_little(scored.gap):
        return "not_excited", 1.0
    explained, missed = found.explained.sum(), found.missed.sum()
    left = left_somewhere(found, scored)
    if not causes:
        return ("unexplained", 1.0) if missed > 0 or left or odd else ("no_gap", 0.0)
    share = float(missed / (explained + missed)) if explained + missed > 0 else 0.0
    share = max(share, left_unseen(found, scored))
    if 1.0 - share >= limits.explained and whole and not left:
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
