"""What to run next: the experiment that tells remaining candidates apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid.diagnose.attribute import Search, Term
from hybrid.diagnose.candidates import Candidate
from hybrid.diagnose.diagnosis import Advice
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.menu import Experiment, gap_along, joint_number, menu
from hybrid.diagnose.separation import Rival, contrast, fit_rival, separation
from hybrid.diagnose.thresholds import thresholds
from hybrid.errors import HybridError
from hybrid.excitation.experiments import speed_ladder
from hybrid.excitation.folder import write_reference

if TYPE_CHECKING:
    from hybrid.diagnose.diagnose import Result

_CLEARLY = 2.0  # times the evidence that is needed
_MOST_PAIRS = 6
_SHORTLIST = 4  # experiments for which all is fitted anew
_THERMAL = "thermal_friction"  # the one to which it matters when a motion is run
_MOST_JOINTS = 3
_SLOW_ENOUGH = 4.0  # s at one speed
_RATE = 500.0  # Hz, of references at most
# Pairs that have the same torque on every motion, and what differs without one.
_ALIKE = {
    frozenset({"torque_offset", "asymmetric_friction"}): (
        "log the torque of {joint} at rest with its brake on and the drive off: a "
        "shifted sensor shows its offset, friction shows none"
    ),
    frozenset({"payload", "link_inertia"}): (
        "take off what the arm carries and repeat a motion"
    ),
}
# What a residual depends on (see `ceiling`), and which experiment isolates that.
_SHOWS = (
    ("past", "a multisine"),
    ("time", "a random motion of all joints again"),
    ("wave", "a ladder of speeds"),
    ("load", "moves between poses"),
    ("position of", "moves between poses"),
    ("posture", "moves between poses"),
    ("acceleration", "one path"),
    ("", "a ladder of speeds"),
)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Advice with its experiment, before anything is written."""

    advice: Advice
    experiment: Experiment | None = None


def advise(
    result: Result, rng: np.random.Generator, *, directory: str | Path | None = None
) -> tuple[Advice, ...]:
    """Experiments that the recordings call for, the most wanted first.

    For findings that other effects explain as well, that experiment of a safe menu is
    taken in which the fitted explanations differ most in torque, after each has been
    allowed to follow the other, if that is enough to tell them apart. For what is
    unexplained it is one that isolates what the residual depends on, and for joints
    that did not move enough a ladder of speeds.

    Args:
        result: A diagnosis with what led to it.
        rng: Source of random motions.
        directory: A folder that exists, for references as CSV files (time, position,
            speed, acceleration); nothing is written by default.

    Returns:
        Advice; none where all is explained and told apart.
    """
    rate = min(_RATE, result.gap.motions[0].rate)
    plans = [
        *sorted(_between_rivals(result, rng, rate), key=lambda p: -p.advice.separation),
        *_for_unexplained(result, rng, rate),
        *_for_not_excited(result, rate),
    ]
    advice, files = [], dict[int, str]()
    for plan in plans:
        ask, file = plan.experiment, ""
        if ask is not None and directory is not None:
            # One experiment may tell several pairs apart.
            file = files.setdefault(id(ask), f"advice_{len(files) + 1}.csv")
            path = Path(directory) / file
            write_reference(path, ask.reference, result.gap.robot.joints)
        advice.append(replace(plan.advice, file=file))
    return tuple(advice)


def rivals(search: Search, term: Term, ids: Sequence[str]) -> list[Candidate]:
    """The best candidates at a term's joint for some ids of effects, shapes fitted.

    Args:
        search: A search that has run.
        term: One of its terms.
        ids: Effects that explain as much.
    """
    base, limits = search.base(term), thresholds()
    _, own = search.refine(base, term.candidate)
    least = own - max(limits.alike, limits.alike_share * own)
    joint, found = term.place[1][-1], dict[str, tuple[Candidate, float]]()
    for c, _ in search.ranked(base):
        if c.place[0] in ids and c.place != term.place and joint in c.place[1]:
            refined, gain = search.refine(base, c)
            better = c.place[0] not in found or gain > found[c.place[0]][1]
            if gain > least and better:
                found[c.place[0]] = refined, gain
    return [c for c, _ in found.values()]


def _between_rivals(
    result: Result, rng: np.random.Generator, rate: float
) -> Iterator[_Plan]:
    """One experiment for each pair of a term and an effect that explains as much."""
    search, joints = result.search, result.gap.robot.joints
    named = {f.effect: f.alternatives[1:] for f in result.diagnosis.findings}
    dishes: dict[int, list[tuple[Experiment, Gap]]] = {}
    seen: set[tuple[int, frozenset[str]]] = set()
    for term in search.terms:
        effect_id, joint = term.place[0], term.place[1][-1]
        ids = named.get(effect_id, ())
        if not ids:
            continue
        own = fit_rival(search, term, term.candidate)
        for other in rivals(search, term, ids):
            pair = frozenset({effect_id, other.place[0]})
            if (joint, pair) in seen or len(seen) >= _MOST_PAIRS:
                continue
            seen.add((joint, pair))
            if pair in _ALIKE:
                text = _ALIKE[pair].format(joint=joints[joint])
                yield _Plan(Advice(text, tuple(sorted(pair)), 0.0))
                continue
            if joint not in dishes:
                found = menu(result.gap.robot, joint, rng, rate=rate)
                dishes[joint] = [(e, gap_along(result.gap, e)) for e in found]
            plan = _best(search, own, fit_rival(search, term, other), dishes[joint])
            if plan is not None:
                yield plan


def _best(
    search: Search,
    first: Rival,
    second: Rival,
    dishes: Sequence[tuple[Experiment, Gap]],
) -> _Plan | None:
    """The experiment that tells two explanations apart best, if any does."""
    noise, splits = search.evidence.noise, (first.effect.id, second.effect.id)
    fit = [d for d in dishes if d[0].start == 0 or _THERMAL in splits]
    sizes = [separation(gap, noise, first, second) for _, gap in fit]
    judged = [
        (contrast(search, fit[k][1], first, second), sizes[k], fit[k][0])
        for k in np.argsort(sizes)[: -_SHORTLIST - 1 : -1]
    ]
    told, size, experiment = max(judged, key=lambda x: x[0], default=(0.0, 0.0, None))
    if experiment is None or told < _CLEARLY:
        return None
    return _Plan(Advice(_run(experiment), splits, size), experiment)


def _for_unexplained(
    result: Result, rng: np.random.Generator, rate: float
) -> Iterator[_Plan]:
    """What isolates the variable that the unexplained part depends on."""
    if result.diagnosis.verdict not in ("unexplained", "partly_explained"):
        return
    joint = int(np.argmax(result.account.missed))
    missed, depends = result.account.missed[joint], result.account.depends[joint]
    if missed <= 0:
        return
    wanted = next(begin for word, begin in _SHOWS if word in depends)
    for experiment in menu(result.gap.robot, joint, rng, rate=rate):
        if experiment.name.startswith(wanted):
            advice = Advice(_run(experiment), (), float(np.sqrt(missed)))
            yield _Plan(advice, experiment)
            return


def _for_not_excited(result: Result, rate: float) -> Iterator[_Plan]:
    """A ladder of speeds for joints that did not move, or in one direction only."""
    robot, count = result.gap.robot, 0
    for j, name in enumerate(robot.joints):
        wanting = [
            text
            for text in result.diagnosis.not_excited
            if text == name or text.startswith((f"{name} does", f"{name} moving"))
        ]
        if not wanting or count >= _MOST_JOINTS:
            continue
        try:
            ladder = speed_ladder(
                robot, joint_number(j), longest=_SLOW_ENOUGH, rate=rate
            )
        except HybridError:
            continue  # no room for it; nothing safe can be said
        count += 1
        experiment = Experiment(f"a ladder of speeds of {name}, up and down", ladder)
        yield _Plan(Advice(_run(experiment), (), 0.0), experiment)


def _run(experiment: Experiment) -> str:
    return f"run {experiment.name} ({experiment.reference.t[-1]:.0f} s)"
