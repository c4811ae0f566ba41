"""What to run next: the experiment that tells remaining candidates apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid.diagnosis.advice.along import Along, coarse
from hybrid.diagnosis.advice.menu import Experiment, Menu, gap_along
from hybrid.diagnosis.advice.separation import (
    Outlook,
    Rival,
    fit_rival,
    needed,
    shapes_of,
)
from hybrid.diagnosis.answer.diagnosis import Advice
from hybrid.diagnosis.evidence.candidates import Candidate, Term
from hybrid.diagnosis.explanations.search import Search
from hybrid.effects import Effect, effect_class
from hybrid.effects.effect import Port
from hybrid.excitation.folder import write_reference
from hybrid.threads import one_thread

if TYPE_CHECKING:
    from hybrid.diagnosis.answer.result import Result

_CLEARLY = 1.2  # times the evidence that is needed
_MOST_PAIRS = 6
_SHORTLIST = 4  # experiments for which all is fitted anew
_MOST_JOINTS = 3
_RATE = 500.0  # Hz, of references at most
_WHERE = "; it settles whether it is {} at {} or {} at {}"
_IF_ANY = "; it settles whether it is {}, or else bounds it"
# What a residual depends on (see `ceiling`), and which experiment isolates that.
_SHOWS = (
    ("past", "a multisine"),
    ("recur", "a random motion of all joints twice"),
    ("events", "a random motion of all joints twice"),
    ("lines in time", "a random motion of all joints twice"),
    ("time", "a random motion of all joints again"),
    ("wave", "a ladder of speeds"),
    ("load", "moves between poses"),
    ("position of", "moves between poses"),
    ("posture", "moves between poses"),
    ("acceleration", "one path"),
    ("", "a ladder of speeds"),
)


@dataclass(frozen=True, eq=False)
class Plan:
    """Advice with its experiment, before anything is written."""

    advice: Advice
    experiment: Experiment | None = None


@one_thread
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
    menu = Menu(result.gap.robot, rng, rate=rate)
    prospects = Prospects(result, menu)
    plans = [
        *sorted(_between(result, prospects), key=_least_told),
        *_for_unexplained(result, menu),
        *_for_servos(result, menu),
        *_for_not_excited(result, menu),
    ]
    advice, files, said = [], dict[int, str](), set[tuple[object, frozenset[str]]]()
    for plan in plans:
        ask, file = plan.experiment, ""
        key = ask or plan.advice.experiment, frozenset(plan.advice.splits)
        if key in said:
            continue  # the same effects at another joint
        said.add(key)
        if ask is not None and directory is not None:
            # One experiment may tell several pairs apart.
            file = files.setdefault(id(ask), f"advice_{len(files) + 1}.csv")
            path = Path(directory) / file
            write_reference(path, ask.reference, result.gap.robot.joints)
        advice.append(replace(plan.advice, file=file))
    return tuple(advice)


class Prospects:
    """Outlooks on every experiment of a menu, made when they are asked for.

    Args:
        result: The diagnosis that they are about.
        menu: The experiments.
    """

    def __init__(self, result: Result, menu: Menu) -> None:
        self._gap, self._menu = result.scored.gap, menu
        self._tried = shapes_of(result.search)
        self._noise = result.search.evidence.noise
        rows = result.search.evidence.rows
        self._recorded = Along(coarse(self._gap), self._noise, rows)
        self._known: dict[Experiment, Outlook] = {}

    def about(self, joint: int, *, warm: bool) -> list[Experiment]:
        """Experiments that may tell something about a joint.

        Args:
            joint: The joint.
            warm: Whether it matters how warm the drives are.
        """
        found = self._menu.about(joint)
        return [x for x in found if not x.gains and (warm or x.start == 0)]

    def __getitem__(self, experiment: Experiment) -> Outlook:
        if experiment not in self._known:
            gap = gap_along(self._gap, experiment)
            # What a sample says goes with the time that it stands for.
            noise = self._noise * gap.rate / self._gap.rate
            ahead = Along(gap, noise)
            alone = experiment.mass > 0
            outlook = Outlook(self._tried, self._recorded, ahead, alone=alone)
            self._known[experiment] = outlook
        return self._known[experiment]


def _between(result: Result, prospects: Prospects) -> Iterator[Plan]:
    """One experiment for each pair of a term and what explains as much."""
    search, joints = result.search, result.gap.robot.joints
    pairs = [(term, c) for term, others in result.alike.items() for c in others]
    own: dict[int, Rival] = {}
    chosen: dict[int, list[Experiment]] = {}
    for term, other in pairs[:_MOST_PAIRS]:
        if by_hand := _by_hand(term.candidate.effect, other.effect):
            text = by_hand.format(joint=joints[term.place[1][-1]])
            ids = tuple(sorted((term.place[0], other.place[0])))
            yield Plan(Advice(text, ids, 0.0))
            continue
        key = id(term)
        if key not in own:
            own[key], chosen[key] = fit_rival(search, term, term.candidate), []
        both = own[key], fit_rival(search, term, other)
        at = dict.fromkeys(c.place[1][-1] for c in (term, other))
        plan = choose(prospects, tuple(at), both, chosen[key])
        if plan is not None:
            yield plan if len(at) == 1 else _placed(search, plan, (term, other))


def _by_hand(one: Effect, other: Effect) -> str:
    """What tells laws apart that have the same torque on every motion."""
    return one.told_apart.get(other.id) or other.told_apart.get(one.id, "")


def _placed(search: Search, plan: Plan, both: Sequence[Term | Candidate]) -> Plan:
    """A plan that says which joints it is about."""
    text = plan.advice.experiment
    if plan.experiment is None or text != _run(plan.experiment):
        return plan  # it tells if it is one of them only
    (one, here), (two, there) = map(search.placed, both)
    laws = one.replace("_", " "), two.replace("_", " ")
    text += _WHERE.format(laws[0], here, laws[1], there)
    return replace(plan, advice=replace(plan.advice, experiment=text))


def _least_told(plan: Plan) -> float:
    return -plan.advice.separation


def choose(
    prospects: Prospects,
    joints: Sequence[int],
    rivals: tuple[Rival, Rival],
    chosen: list[Experiment],
) -> Plan | None:
    """The experiment that tells two explanations apart best, if any does.

    One that is advised already is taken if it does, and then one that takes no more
    than to run a motion. If all that can be told is that one of them is the true one,
    as the other law becomes it at a limit, that is better than nothing.

    Args:
        prospects: What experiments would tell.
        joints: Joints that the explanations are about.
        rivals: Two explanations.
        chosen: Experiments that are advised already; what is chosen is added.

    Returns:
        The advice; nothing if no experiment tells enough.
    """
    splits = rivals[0].effect.id, rivals[1].effect.id
    warm = any(effect_class(x).warms for x in splits)
    menu = list(dict.fromkeys(x for j in joints for x in prospects.about(j, warm=warm)))
    known = [x for x in chosen if x.plain]
    plain = [x for x in menu if x.plain and x not in known]
    half: tuple[float, Plan | None] = _CLEARLY, None
    for dishes in (known, plain, [x for x in menu if not x.plain]):
        sizes = [prospects[x].separation(*rivals) for x in dishes]
        best: tuple[float, Plan | None] = _CLEARLY, None
        for k in np.argsort(sizes)[: -_SHORTLIST - 1 : -1]:
            # Half the square bounds what it adds; the recordings tell too little.
            if sizes[k] ** 2 / 2 < (_CLEARLY - 1) * needed(rivals[0].evidence):
                break
            told = prospects[dishes[k]].contrast(*rivals)
            text = _run(dishes[k])
            if min(told) > best[0]:
                plan = Plan(Advice(text, splits, sizes[k]), dishes[k])
                best = min(told), plan
            if max(told) > half[0]:
                text += _IF_ANY.format(splits[int(np.argmax(told))].replace("_", " "))
                half = max(told), Plan(Advice(text, splits, sizes[k]), dishes[k])
        if best[1] is not None:
            break
    found = best[1] or half[1]
    if found and found.experiment not in chosen:
        chosen += [found.experiment] if found.experiment else []
    return found


def _for_unexplained(result: Result, menu: Menu) -> Iterator[Plan]:
    """What isolates the variable that the unexplained part depends on."""
    if result.diagnosis.verdict not in ("unexplained", "partly_explained"):
        return
    joint = int(np.argmax(result.account.missed))
    missed, depends = result.account.missed[joint], result.account.depends[joint]
    if missed <= 0:
        return
    wanted = next(begin for word, begin in _SHOWS if word in depends)
    for experiment in menu.about(joint):
        if experiment.name.startswith(wanted):
            advice = Advice(_run(experiment), (), float(np.sqrt(missed)))
            yield Plan(advice, experiment)
            return


def _for_not_excited(result: Result, menu: Menu) -> Iterator[Plan]:
    """A ladder of speeds for joints that did not move, or in one direction only."""
    count = 0
    for j, name in enumerate(result.gap.robot.joints):
        wanting = [
            text
            for text in result.diagnosis.not_excited
            if text == name or text.startswith((f"{name} does", f"{name} moving"))
        ]
        if not wanting or count >= _MOST_JOINTS:
            continue
        for experiment in menu.ladder(j):
            count += 1
            yield Plan(Advice(_run(experiment), (), 0.0), experiment)


def _for_servos(result: Result, menu: Menu) -> Iterator[Plan]:
    """Other gains, where it is not settled what of a servo is not as it should be."""
    for finding in result.diagnosis.findings:
        ids = finding.alternatives
        if len(ids) < 2 or effect_class(ids[0]).port is not Port.COMMAND:
            continue
        for experiment in menu.of_all_joints:
            if experiment.gains:
                yield Plan(Advice(_run(experiment), ids, 0.0), experiment)


def _run(experiment: Experiment) -> str:
    return f"run {experiment.name} ({experiment.reference.t[-1]:.0f} s)"
