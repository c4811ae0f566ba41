"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
from hybrid.diagnosis.evidence.convention import Convention
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
from hybrid.identification.preparation import checked_logs
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
_STRAINED = (
    "numbers of the file at {} take up the gap there, and are farther off than files "
    "usually are"
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
    tell, rng = progress or (lambda _: None), np.random.default_rng(seed)
    tell("measuring the gap")
    case = _Case.of(robot, recordings, cutoff, without)
    result = _explained(case, tell, rng)
    if result.diagnosis.verdict == "not_excited":
        return result
    tell("finding where the gap lies")
    floor = np.array(result.diagnosis.noise_floor)
    where = locate(case.as_logged, floor, rng)
    diagnosis = replace(result.diagnosis, where=where)
    # Torque that was taken from the logs was asked for.
    if case.doubts or case.healthy:
        return replace(result, diagnosis=diagnosis)
    tell("asking whether torque follows the command")
    distorted = {j for e in result.effects if e.reports for j in e.joints}
    link = command_link(
        case.gap, case.recordings, rng, without=case.without, distorted=distorted
    )
    diagnosis = joined(diagnosis, result.account, case.as_logged, link, rng)
    return replace(result, diagnosis=diagnosis, command=link.effects)


@dataclass(frozen=True, eq=False)
class _Case:
    """Logs, and how they differ from a simulator.

    Attributes:
        recordings: The logs, with what their writer did taken back.
        logged: How they were written.
        gap: Their gap.
        as_logged: The gap with the log taken at its word where torque in it is late.
        without: Ids of effects to leave out of the library.
        healthy: What is known of the arm beyond its file, if a model is the simulator.
    """

    recordings: Sequence[Recording | Motion]
    logged: Convention
    gap: Gap
    as_logged: Gap
    without: tuple[str, ...]
    healthy: Baseline | None

    @classmethod
    def of(
        cls,
        robot: Robot | DynamicModel,
        recordings: Sequence[Recording | Motion],
        cutoff: float | None,
        without: Sequence[str],
    ) -> _Case:
        """Measure the gap of logs; see :func:`diagnose`."""
        healthy = None
        if isinstance(robot, DynamicModel):
            healthy = Baseline(robot)
            robot, without = healthy.robot, [*without, *healthy.constant]
        recordings = since_first(checked_logs(robot, recordings))
        if healthy:
            recordings = healthy.taken_from(recordings)
        logged, recordings, *gaps = measured(
            robot, recordings, cutoff, clocks=Delay.id not in without
        )
        gap, as_logged = map(healthy.beside, gaps) if healthy else gaps
        return cls(recordings, logged, gap, as_logged, tuple(without), healthy)

    @cached_property
    def doubts(self) -> list[str]:
        """Why nothing can be said of such logs."""
        return [x for x in (too_little(self.gap), unlike(self.gap)) if x is not None]

    @property
    def known(self) -> tuple[Effect, ...]:
        """Effects of the model that is the simulator."""
        return self.healthy.model.effects if self.healthy else ()


def _explained(case: _Case, tell: Progress, rng: np.random.Generator) -> Result:
    """What explains the torque of some logs, and what is left."""
    gap, logged, doubts = case.gap, case.logged, list(case.doubts)
    # Torque that is late at every joint is no term: it is taken back already.
    late = [Delay.id] if logged.clocks else []
    search = Search(gap, split(gap), without=[*case.without, *late])
    if not doubts:
        tell("looking for the most probable explanation")
        search.run()
    reached = account(search).ceiling
    named, alike = _believed(search, doubts)
    found, far = account(search, reached), search.strained(search.causes)
    if far:
        doubts.append(_STRAINED.format(", ".join(gap.robot.joints[j] for j in far)))
    search.stand_in()
    kinds = [named.get(c, ()) for c in search.known]
    tell("scoring on motions that no step has seen")
    scored, effects = explain(search), refit(gap, search)
    shown, left = unseen(search, found), left_unseen(scored, found, search)
    causes = findings(scored, effects, kinds, shares(search, rng), rng)
    doubts += [_ONCE.format(f.effect) for f in causes if _once(f, scored)]
    if search.off > search.prior.file[1]:
        doubts.append(_FAR.format(search.off) if search.off < 1 else _PLACEHOLDERS)
    if logged.clocks and not case.doubts:
        apart, others = clocks_apart(case.as_logged, scored, logged, rng)
        causes, effects = apart.joined(causes, others), (*effects, *apart.effects)
        found = replace(found, before=found.before + apart.squares)
    off = bool(far) or (not causes and search.off > search.prior.file[1])
    verdict = _verdict(gap, found, causes, left, off=off)
    diagnosis = replace(
        _diagnosis(case.as_logged, search, found, causes, *verdict),
        unseen=shown,
        events=events_at_rest(case.as_logged),
        warnings=(*gap.notes, *logged.notes, *doubts),
    )
    return Result(diagnosis, case.as_logged, search, scored, found, effects,
                  alike=alike, healthy=case.known)  # fmt: skip


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
    gap: Gap,
    found: Account,
    causes: Sequence[Finding],
    left: float,
    *,
    off: bool,
) -> tuple[Verdict, float]:
    """What it comes to, and the unexplained share of the explainable gap.

    Args:
        gap: The gap.
        found: What is explained of it where that was learnt.
        causes: What is named.
        left: Part of it that is left on unseen motions.
        off: Whether numbers of the file are farther off than files usually are, with no
            cause that explains it.
    """
    if too_little(gap):
        return "not_excited", 1.0
    if not causes:
        missed = off or bool(found.missed.sum() > 0) or unlike(gap) is not None
        return ("unexplained", 1.0) if missed else ("no_gap", 0.0)
    share, whole = max(found.unknown, left), found.explained + found.missed
    # A joint whose gap has no cause is not explained by what is found at others.
    alone = (found.missed > found.explained) & (found.missed > 0.05 * whole.sum())
    if 1.0 - share >= _EXPLAINED and not alone.any() and not off:
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
