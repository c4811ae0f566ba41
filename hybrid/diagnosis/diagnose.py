"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer.clocks import clocks_apart
from hybrid.diagnosis.answer.command import command_link
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Finding, Verdict
from hybrid.diagnosis.answer.events import events_at_rest
from hybrid.diagnosis.answer.findings import findings
from hybrid.diagnosis.answer.links import joined
from hybrid.diagnosis.answer.locate import locate
from hybrid.diagnosis.answer.replayed import replayed
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.unseen import left_unseen, unseen
from hybrid.diagnosis.evidence.candidates import Candidate
from hybrid.diagnosis.evidence.logs import measured, since_first
from hybrid.diagnosis.evidence.term import Term
from hybrid.diagnosis.explanations.account import Account, account
from hybrid.diagnosis.explanations.belief import unknown_worth
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.explanation import Explanation, explain, shares
from hybrid.diagnosis.explanations.refit import refit
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.baseline import Baseline
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.grounds import too_little, unlike
from hybrid.diagnosis.gap.split import split
from hybrid.diagnosis.gap.units import units
from hybrid.diagnosis.gap.visited import not_excited
from hybrid.effects import Effect
from hybrid.effects.delay import Delay
from hybrid.identification.preparation import taken
from hybrid.model import DynamicModel
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.threads import one_thread

Progress = Callable[[str], None]

_EXPLAINED = 0.9  # of the squares above noise, of a gap that is explained
_HALF = 0.5
_ONCE = (
    "{} acts only in what was learnt from: its shrinkage is on the same samples, not "
    "on motions that no step has seen"
)
_FAR = (
    "the numbers of the file are off by some {:.0%}: that is a gap of its own, and "
    "small errors of single links are not told from it"
)
_PLACEHOLDERS = (
    "the numbers of the file look like placeholders: the logs ask for quite others, "
    "and errors of single links are not told from that"
)
_WHERE = "{} at {} may as well be {} at {}: these motions do not tell"


def diagnose(
    robot: Robot | DynamicModel,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a sim-to-real gap lies, what causes it, and how far it shrinks.

    Args:
        robot: The simulator as it stands today; or a model of the healthy arm, which
            is to say what has changed since.
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
    robot: Robot | DynamicModel,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Result:
    """:func:`diagnose` in torque, with everything that led to the answer."""
    healthy = None
    if isinstance(robot, DynamicModel):
        healthy = Baseline(robot)
        robot, without = healthy.robot, [*without, *healthy.constant]
    recordings = since_first(taken(robot, recordings))
    tell, rng = progress or (lambda _: None), np.random.default_rng(seed)
    tell("measuring the gap")
    if healthy:
        recordings = healthy.taken_from(recordings)
    logged, recordings, gap, as_logged = measured(
        robot, recordings, cutoff, clocks=Delay.id not in without
    )
    if healthy:
        gap, as_logged = healthy.beside(gap), healthy.beside(as_logged)
    # Torque that is late at every joint is no term: it is taken back already.
    late = [Delay.id] if logged.clocks else []
    search = Search(gap, split(gap), without=[*without, *late])
    doubts = [x for x in (too_little(gap), unlike(gap)) if x is not None]
    foreign = bool(doubts)
    if not foreign:
        tell("looking for the most probable explanation")
        search.run()
    reached = account(search).ceiling
    named, alike = _believed(search, doubts)
    found = account(search, reached)
    search.stand_in()
    kinds = [named.get(c, ()) for c in search.known]
    tell("scoring on motions that no step has seen")
    scored = explain(search)
    effects, shown = refit(gap, search), unseen(search, found)
    causes = findings(scored, effects, kinds, shares(search, rng), rng)
    doubts += [_ONCE.format(f.effect) for f in causes if _once(f, scored)]
    if search.off > search.prior.file[1]:
        far = _FAR.format(search.off) if search.off < 1.0 else _PLACEHOLDERS
        doubts.append(far)
    if logged.clocks and not foreign:
        apart, others = clocks_apart(as_logged, scored, logged, rng)
        causes, effects = apart.joined(causes, others), (*effects, *apart.effects)
        found = replace(found, before=found.before + apart.squares)
    verdict, unexplained = _verdict(
        gap, found, causes, left_unseen(scored, found, search)
    )
    diagnosis = replace(
        _diagnosis(as_logged, search, found, causes, verdict, unexplained),
        unseen=shown,
        events=events_at_rest(as_logged),
        warnings=(*gap.notes, *logged.notes, *doubts),
    )
    command: tuple[Effect, ...] = ()
    if verdict != "not_excited":
        tell("finding where the gap lies")
        where = locate(as_logged, np.array(diagnosis.noise_floor), rng)
        diagnosis = replace(diagnosis, where=where)
    # Torque that was taken from the logs was asked for.
    if verdict != "not_excited" and not foreign and not healthy:
        tell("asking whether torque follows the command")
        distorted = {j for e in effects if e.reports for j in e.joints}
        link = command_link(gap, recordings, rng, without=without, distorted=distorted)
        diagnosis = joined(diagnosis, found, as_logged, link, rng)
        command = link.effects
    return Result(
        diagnosis, as_logged, search, scored, found, effects, command, alike,
        healthy.model.effects if healthy else (),
    )  # fmt: skip


def _believed(
    search: Search, doubts: list[str]
) -> tuple[dict[Cause, tuple[str, ...]], dict[Term, tuple[Candidate, ...]]]:
    """Leave a search the causes that are more probable than something unknown.

    Returns:
        Ids that each cannot be told from, itself first; and what explains as much in
        its place: at its joint, and the most probable at another one.
    """
    beliefs = [b for b in search.beliefs if b.probability > _HALF]
    beliefs = [b for b in beliefs if b.worth > unknown_worth(search, b.cause)]
    kept = {b.cause for b in beliefs}
    search.causes = [c for c in search.causes if c.candidate is None or c in kept]
    kinds, alike, names = {}, {}, search.gap.robot.joints
    for b, term in zip(beliefs, search.terms, strict=True):
        known = [x.candidate for x, _ in b.alike if x.candidate is not None]
        here = [c for c in known if {*c.place[1]} & {*term.place[1]}]
        there = [c for c in known if c not in here][:1]
        kinds[b.cause] = tuple(dict.fromkeys(c.place[0] for c in here))
        alike[term] = tuple(c for c in (*here, *there) if c.place != term.place)
        for c in there:
            both = (term.place, c.place)
            said = (w for e, at in both for w in (e, names[at[-1]]))
            doubts.append(_WHERE.format(*said))
    return kinds, alike


def _once(finding: Finding, scored: Explanation) -> bool:
    return scored.where_seen(scored.members(finding.effect)) is not scored


def _verdict(
    gap: Gap, found: Account, causes: Sequence[Finding], left: float
) -> tuple[Verdict, float]:
    """What it comes to, and the unexplained share of the explainable gap.

    Args:
        gap: The gap.
        found: What is explained of it where that was learnt.
        causes: What is named.
        left: Part of it that is left on unseen motions.
    """
    if too_little(gap):
        return "not_excited", 1.0
    if not causes:
        missed = bool(found.missed.sum() > 0) or unlike(gap) is not None
        return ("unexplained", 1.0) if missed else ("no_gap", 0.0)
    share, whole = max(found.unknown, left), found.explained + found.missed
    # A joint whose gap has no cause is not explained by what is found at others.
    alone = (found.missed > found.explained) & (found.missed > 0.05 * whole.sum())
    if 1.0 - share >= _EXPLAINED and not alone.any():
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
    floor = np.sqrt(np.maximum(found.noise, 0.0) * search.noise / count)
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
