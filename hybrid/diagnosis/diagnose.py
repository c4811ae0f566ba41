"""Diagnosis of a simulator from logs of the real arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer.command import command_link
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Finding
from hybrid.diagnosis.answer.events import contacts_in_motion, events_at_rest
from hybrid.diagnosis.answer.findings import findings, implausible
from hybrid.diagnosis.answer.links import delay_finding, merged_links
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.answer.regions import locate
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.unseen import left_unseen, unseen
from hybrid.diagnosis.answer.words import effect_words, effects_listed, headline
from hybrid.diagnosis.evidence.candidates import Candidate, Term
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.evidence.logs import measured, since_first
from hybrid.diagnosis.explanations.account import account
from hybrid.diagnosis.explanations.belief import is_known
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.explanation import Explanation, explain, shares
from hybrid.diagnosis.explanations.refit import refit
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.baseline import Baseline
from hybrid.diagnosis.gap.coverage import not_excited, too_little_motion
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.likeness import Unlike, unlike
from hybrid.diagnosis.gap.measure import split
from hybrid.diagnosis.scale import in_doubt, settled, weighed
from hybrid.diagnosis.verdict import verdict_of
from hybrid.effects import Port, effect_at
from hybrid.identification.preparation import checked_logs
from hybrid.model import DynamicModel
from hybrid.progress import Progress, silent
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.threads import one_thread

_UNTESTED = "no held-out motion shows {}: shrinkage is measured on the training samples"
_FILE_ERRORS = (
    "masses and inertias of the file are off by about {:.0%}, a gap by themselves: "
    "smaller errors of single links cannot be found"
)
_PLACEHOLDERS = (
    "masses and inertias of the file look like placeholders, far from the arm's: "
    "errors of single links cannot be found"
)
_DOUBTFUL = (
    "numbers of the file at {} would explain the gap there, but with larger errors "
    "than files usually have"
)
_OTHER_JOINT = "{} at {} may as well be {} at {}: these motions cannot tell them apart"


@typed
def diagnose(
    robot: Robot | DynamicModel,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    known_mass: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find where a sim-to-real gap lies, what causes it, and how far it shrinks.

    Args:
        robot: The simulator; or a model of the healthy arm, to find what has changed.
        recordings: Logs of the real arm: time, position and torque. A log with missing
            samples counts as several.
        cutoff: Cut-off of the low-pass filter, [Hz]; chosen from the spectrum if not
            given.
        without: Ids of effects to leave out of the library.
        known_mass: Masses by joint, [kg], which settle the scale of torque: of the link
            that the joint moves; with a model, of what was mounted on it since.
        seed: Seed of the bootstrap.
        progress: Called with the name of each step, and the share of the work that is
            done, or None where that is not known.

    Raises:
        IdentificationError: There is no recording, or none shows a known mass.
        RobotError: A known mass is at no joint of the arm, or not above 0.
        RecordingError: A recording does not fit the arm.
    """
    rng = np.random.default_rng(seed)
    result = examine(
        robot,
        recordings,
        cutoff=cutoff,
        without=without,
        known_mass=known_mass,
        seed=seed,
        progress=progress,
    )
    result = with_motion_gap(result, rng, progress=progress)
    return replace(result.diagnosis, advice=advise(result, rng))


@one_thread
def examine(
    robot: Robot | DynamicModel,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    known_mass: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Result:
    """:func:`diagnose` without replay and advice, with all intermediate results."""
    tell, rng = progress or silent, np.random.default_rng(seed)
    known = known_mass or {}
    robot, notes = weighed(robot, known)
    tell("measuring the gap", 0.0)
    case = _Case.of(robot, recordings, cutoff, without)
    result = _examined(case, tell, rng)
    found = result.diagnosis
    if case.healthy:  # a file's masses set the scale, those of a model are on the log's
        found = settled(found, result.effects, known) if known else in_doubt(found)
    warnings = (*found.warnings, *notes)
    found = replace(found, sentence=headline(found), warnings=warnings)
    return replace(result, diagnosis=found)


def _examined(case: _Case, tell: Progress, rng: np.random.Generator) -> Result:
    """Explain torque, say where the gap lies, and compare torque and command."""
    result = _explained(case, tell, rng)
    if result.diagnosis.verdict == "not_excited":
        return result
    tell("finding where the gap lies", 0.8)
    floor = np.array(result.diagnosis.noise_floor)
    where = locate(case.as_logged, floor, rng)
    diagnosis = replace(result.diagnosis, where=where)
    # Without the torque of a healthy model a log does not show the servo.
    if case.too_little or case.healthy:
        return replace(result, diagnosis=diagnosis)
    tell("asking whether torque follows the command", 0.8)
    distorted = {j for e in result.effects if e.reports for j in e.joints}
    link = command_link(
        case.gap, case.recordings, rng, without=case.without, distorted=distorted
    )
    diagnosis = merged_links(diagnosis, result.account, case.as_logged, link, rng)
    return replace(result, diagnosis=diagnosis, command=link.effects)


@dataclass(frozen=True, eq=False)
class _Case:
    """Corrected logs and their gap."""

    recordings: Sequence[Recording | Motion]  # the corrected logs
    logged: Convention
    gap: Gap
    as_logged: Gap  # without the correction for torque that another clock stamped
    without: tuple[str, ...]  # ids of effects to leave out of the library
    healthy: Baseline | None  # the model of the healthy arm, if that is the simulator

    @classmethod
    def of(
        cls,
        robot: Robot | DynamicModel,
        recordings: Sequence[Recording | Motion],
        cutoff: float | None,
        without: Sequence[str],
    ) -> _Case:
        """Correct logs and measure their gap; see :func:`diagnose`."""
        healthy, band = None, None
        if isinstance(robot, DynamicModel):
            healthy = Baseline(robot)
            robot, without = healthy.robot, [*without, *healthy.inborn]
        recordings = since_first(checked_logs(robot, recordings))
        if healthy:
            recordings, band = healthy.subtract_from(recordings)
        clocks = _delay() not in without
        logged, recordings, *gaps = measured(
            robot, recordings, cutoff, clocks=clocks, band=band
        )
        gap, as_logged = map(healthy.with_subtracted, gaps) if healthy else gaps
        return cls(recordings, logged, gap, as_logged, tuple(without), healthy)

    @cached_property
    def too_little(self) -> str | None:
        """Why the logs do not suffice to name a cause; None if they do."""
        return too_little_motion(self.gap)

    @cached_property
    def unlike(self) -> Unlike:
        """What of the file is not as in the logs; empty if they are of one arm."""
        return Unlike("", "") if self.too_little else unlike(self.gap)


def _delay() -> str:
    """Id of the effect that torque is logged late."""
    return effect_at(Port.MEASUREMENT, shifts=True).id


def _searched(case: _Case, tell: Progress) -> Search:
    """Search for causes, unless there is too little motion to name one."""
    gap = case.gap
    # A delay of all torque is corrected already.
    late = [_delay()] if case.logged.clocks else []
    tell("trying every effect at every joint", 0.05)
    search = Search(gap, split(gap), without=[*case.without, *late])
    if case.too_little:
        return search
    tell("looking for the most probable explanation", 0.2)
    search.run(tell)
    once = search.happened_in_test()
    if once.any():
        tell("looking again, with what happened once", 0.5)
        search = Search(gap, search.learn | once, search.pool.without)
        search.run(tell)
    return search


def _explained(case: _Case, tell: Progress, rng: np.random.Generator) -> Result:
    """Explain the torque of some logs."""
    gap, logged, search = case.gap, case.logged, _searched(case, tell)
    doubts = [x for x in (case.too_little, case.unlike.doubt) if x]
    reached = account(search).ceiling
    named, alike = _drop_improbable(search, doubts)
    found, far = account(search, reached), search.doubtful_joints(search.causes)
    if far:
        doubts.append(_DOUBTFUL.format(", ".join(gap.robot.joints[j] for j in far)))
    search.substitute_unknown_laws()
    kinds = [named.get(c, {}) for c in search.known]
    tell("scoring on held-out motion", 0.75)
    scored, effects = explain(search), refit(search)
    each = zip(search.known, kinds, scored.named, strict=True)
    certain = [c for c, kind, name in each if kind or name != c.place[0]]
    shown, left = unseen(search, found, certain), left_unseen(scored, found)
    causes = findings(scored, effects, kinds, shares(search, rng), rng)
    doubts += [*_untested(scored, causes), *implausible(causes)]
    error, typical = search.file_error, search.prior.file_errors[1]
    if error > typical:
        doubts.append(_FILE_ERRORS.format(error) if error < 1 else _PLACEHOLDERS)
    if logged.clocks and not case.too_little:
        apart, others = delay_finding(case.as_logged, scored, logged, rng)
        causes, effects = apart.merged(causes, others), (*effects, *apart.effects)
        found = replace(found, before=found.before + apart.squares)
    doubtful = bool(far or case.unlike.short) or (not causes and error > typical)
    verdict, unexplained = verdict_of(found, causes, shown, left, doubtful=doubtful)
    if case.too_little:
        verdict, unexplained = "not_excited", 1.0
    healthy = case.healthy
    diagnosis = Diagnosis(
        **_sizes(case.as_logged),
        noise_floor=tuple(map(float, np.sqrt(found.noise))),
        where=(),
        findings=causes,
        verdict=verdict,
        unexplained=unexplained,
        background=error,
        unseen=shown,
        events=(*contacts_in_motion(gap, effects), *events_at_rest(case.as_logged)),
        warnings=(*gap.notes, *logged.notes),
        doubts=(*doubts, *(healthy.doubts(effects) if healthy else ())),
        unlike=case.unlike.short,
    )
    return Result(
        diagnosis, case.as_logged, search, scored, found, effects, rivals=alike,
        baseline=healthy.model.effects if healthy else (),
    )  # fmt: skip


def _untested(scored: Explanation, causes: Sequence[Finding]) -> Iterator[str]:
    """That some causes act in no held-out motion."""
    ids = [f.effect for f in causes]
    seen = {x: scored.where_seen(scored.members(x)) for x in ids}
    if untested := [x for x in ids if seen[x] is not scored]:
        yield _UNTESTED.format(effects_listed(untested, "and"))


def _drop_improbable(
    search: Search, doubts: list[str]
) -> tuple[dict[Cause, dict[str, float]], dict[Term, tuple[Candidate, ...]]]:
    """Remove causes from a search that are less probable than an unknown law."""
    # What is left is told by the effects that may be in each cause's place at its
    # joint, with their probabilities, its own first; and by the rivals of each: these,
    # the most probable one at another joint, which is doubted, and those that only
    # priors tell from it.
    beliefs = [b for b in search.beliefs if b.worth > 0 and is_known(search, b.cause)]
    kept = {b.cause for b in beliefs}
    search.causes = [c for c in search.causes if c.candidate is None or c in kept]
    kinds, alike, names = {}, {}, search.gap.robot.joints
    for b, term in zip(beliefs, search.terms, strict=True):
        known = {x.candidate: p for x, p in b.alternatives if x.candidate is not None}
        here = [c for c in known if {*c.place[1]} & {*term.place[1]}]
        there = [c for c in known if c not in here][:1]
        likely = dict.fromkeys((c.place[0] for c in here), 0.0)
        for c in here:
            likely[c.place[0]] += float(known[c])
        kinds[b.cause] = likely
        others = {c.place: c for c in (*here, *there, *b.equals)}
        others.pop(term.place, None)
        alike[term] = tuple(others.values())
        for c in there:
            both = (term.place, c.place)
            said = (w for e, at in both for w in (effect_words(e), names[at[-1]]))
            doubts.append(_OTHER_JOINT.format(*said))
    return kinds, alike


def _sizes(gap: Gap) -> dict[str, Any]:
    """The arm, what its motions lack, and the size of its gap by joint."""
    count = np.maximum(gap.moving.sum(axis=0), 1)
    rms, size = (
        np.sqrt((np.where(gap.moving, x, 0.0) ** 2).sum(axis=0) / count)
        for x in (gap.left, gap.measured)
    )
    return {
        "robot": gap.robot.name,
        "joints": gap.robot.joints,
        "units": gap.robot.chain.units("N·m"),
        "not_excited": not_excited(gap),
        "rms": tuple(map(float, rms)),
        "relative": tuple(map(float, rms / np.where(size > 0, size, np.inf))),
    }
