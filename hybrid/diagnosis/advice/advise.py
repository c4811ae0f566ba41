"""Advise experiments that distinguish candidate effects."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from pathlib import Path

import numpy as np

from hybrid.diagnosis.advice.menu import Experiment, Menu, gap_along
from hybrid.diagnosis.advice.separation import (
    Discrimination,
    Rival,
    decimated,
    fit_rival,
    required_evidence,
)
from hybrid.diagnosis.answer.diagnosis import ABOVE, Advice
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.words import effect_words
from hybrid.diagnosis.evidence.candidates import Candidate, Term
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics.kinematics import frames
from hybrid.effects import Port, effect_class
from hybrid.excitation.design import write_reference
from hybrid.threads import one_thread

_MARGIN = 1.2  # times the required evidence
_MOST_PAIRS = 6
_SHORTLIST = 4  # experiments for which shapes are fitted
_MOST_JOINTS = 3
_RATE = 500.0  # Hz, highest of references
_WHERE = "; it settles whether it is {} at {} or {} at {}"
_IF_ANY = "; it shows {}, or how small it is"
_CAUTION = " (it reaches {:.2g} m lower than these logs: look at the cell first)"
_DEEPER = 0.05  # m
_WIDE = "a fast random motion"
_TOGETHER = (
    ", and diagnose it together with these logs: they tell too little of the torque of "
    "{} on other motion"
)
# Words of the variable that a residual depends on; start of the experiment's name.
_ISOLATING = (
    ("past", "a multisine"),
    ("recur", "a random motion of all joints twice"),
    ("waves in time", "a random motion of all joints twice"),
    ("time", "a random motion of all joints again"),
    ("wave", "a ladder of speeds"),
    ("load", "moves between poses"),
    ("position of", "moves between poses"),
    ("acceleration", "one path"),
    ("", "a ladder of speeds"),
)


_Told = Callable[[Experiment], Discrimination]


@dataclass(frozen=True, eq=False)
class Plan:
    """Advice with its experiment, before anything is written."""

    advice: Advice
    experiment: Experiment | None = None


@one_thread
def advise(
    result: Result, rng: np.random.Generator, *, directory: str | Path | None = None
) -> tuple[Advice, ...]:
    """Advise experiments, most useful first; none if nothing is left to tell.

    If another effect explains as much as a finding, the safe experiment with the
    largest separation of the two is taken, if it distinguishes them. For an
    unexplained gap the experiment isolates the variable that the residual depends on;
    for one that other motion shows, it is a wide motion.
    Joints that did not move enough get a ladder of speeds.

    Motions are drawn by ``rng``. References are written as CSV files (time, position,
    speed, acceleration) to a directory, which exists, if one is given.
    """
    rate = min(_RATE, 1.0 / result.gap.period)
    menu = Menu(result.gap.robot, rng, rate=rate)
    search = result.search
    told = cache(partial(_discrimination, search, decimated(search.gap)))
    between = _between(result, menu, told)
    plans = [
        *sorted(between, key=lambda plan: -plan.advice.separation),
        *(_for_unexplained(result, menu) or _for_unforetold(result, menu)),
        *_for_servos(result, menu),
        *_for_not_excited(result, menu),
    ]
    advice, files, given = [], dict[int, str](), set[tuple[object, frozenset[str]]]()
    for plan in plans:
        experiment, file = plan.experiment, ""
        key = experiment or plan.advice.experiment, frozenset(plan.advice.splits)
        if key in given:
            continue  # the same effects at another joint
        given.add(key)
        if experiment is not None and directory is not None:
            # Several pairs of effects may share an experiment.
            file = files.setdefault(id(experiment), f"advice_{len(files) + 1}.csv")
            path = Path(directory) / file
            write_reference(path, experiment.reference, result.gap.robot.joints)
        text = plan.advice.experiment
        if experiment is not None:
            text += _caution(result.gap, experiment)
        advice.append(replace(plan.advice, experiment=text, file=file))
    return tuple(advice)


def _caution(gap: Gap, experiment: Experiment) -> str:
    """How much lower than the recordings an experiment reaches, if it does."""
    chain = gap.robot.chain
    down = chain.gravity / max(float(np.linalg.norm(chain.gravity)), 1e-9)
    lowest, recorded = (
        float((frames(chain, q)[1] @ down).max(initial=0.0))
        for q in (experiment.reference.q, gap.sampled.q)
    )
    deeper = lowest - recorded
    return _CAUTION.format(deeper) if deeper > _DEEPER else ""


def _discrimination(
    search: Search, recorded: Gap, experiment: Experiment
) -> Discrimination:
    """The discrimination of an experiment; one with a payload is diagnosed alone."""
    ahead = gap_along(search.gap, experiment)
    return Discrimination(search, ahead, None if experiment.mass else recorded)


def _between(result: Result, menu: Menu, told: _Told) -> Iterator[Plan]:
    """An experiment for each pair of a term and a candidate that explains as much."""
    search, joints = result.search, result.gap.robot.joints
    pairs = [(term, c) for term, others in result.rivals.items() for c in others]
    rival = cache(partial(fit_rival, search))
    chosen = defaultdict[Term, list[Experiment]](list)
    for term, other in pairs[:_MOST_PAIRS]:
        one, two = term.candidate.effect, other.effect
        # Laws with the same torque on every motion are told apart by hand.
        by_hand = one.told_apart.get(two.id) or two.told_apart.get(one.id, "")
        if by_hand:
            text = by_hand.format(joint=joints[term.place[1][-1]])
            ids = tuple(sorted((term.place[0], other.place[0])))
            yield Plan(Advice(text, ids, 0.0))
            continue
        both = rival(term, term.candidate), rival(term, other)
        at = dict.fromkeys(c.place[1][-1] for c in (term, other))
        plan = choose(menu, told, tuple(at), both, chosen[term])
        if plan is not None:
            yield plan if len(at) == 1 else _placed(search, plan, (term, other))


def _placed(search: Search, plan: Plan, both: Sequence[Term | Candidate]) -> Plan:
    """The plan with the joints of both effects in its text."""
    text = plan.advice.experiment
    if plan.experiment is None or text != _run(plan.experiment):
        return plan  # it confirms one of the effects only
    (one, here), (two, there) = map(search.placed, both)
    text += _WHERE.format(effect_words(one), here, effect_words(two), there)
    return replace(plan, advice=replace(plan.advice, experiment=text))


def choose(
    menu: Menu,
    told: _Told,
    joints: Sequence[int],
    rivals: tuple[Rival, Rival],
    chosen: list[Experiment],
) -> Plan | None:
    """Choose the experiment that distinguishes two rivals best, if one does.

    Experiments that are ``chosen`` already are tried first, then those without
    preparation, then the rest; a new one is added to them. If a law is a limit of the
    other, an experiment may confirm only one of them; it is chosen if no experiment
    distinguishes both.
    """
    splits = rivals[0].effect.id, rivals[1].effect.id
    warm = any(effect_class(x).warms for x in splits)
    about = dict.fromkeys(x for j in joints for x in menu.about(j) if not x.gains)
    known = [x for x in chosen if x.plain]
    plain = [x for x in about if x.plain and x not in known]
    prepared = [x for x in about if not x.plain and (warm or x.start == 0)]
    least = (_MARGIN - 1) * required_evidence(rivals[0].evidence)
    one: tuple[float, Plan | None] = _MARGIN, None
    for tried in (known, plain, prepared):
        sizes = [told(x).separation(*rivals) for x in tried]
        both: tuple[float, Plan | None] = _MARGIN, None
        for k in np.argsort(sizes)[: -_SHORTLIST - 1 : -1]:
            # Half the square is an upper bound of the evidence.
            if sizes[k] ** 2 / 2 < least:
                break
            contrast = told(tried[k]).contrast(*rivals)
            if min(contrast) > both[0]:
                both = min(contrast), _plan(tried[k], splits, sizes[k])
            if max(contrast) > one[0]:
                shown = effect_words(splits[int(np.argmax(contrast))])
                text = _IF_ANY.format(shown)
                one = max(contrast), _plan(tried[k], splits, sizes[k], text)
        if both[1] is not None:
            break
    found = both[1] or one[1]
    if found and found.experiment and found.experiment not in chosen:
        chosen.append(found.experiment)
    return found


def _for_unexplained(result: Result, menu: Menu) -> tuple[Plan, ...]:
    """The experiment that isolates the variable of the largest unexplained gap."""
    if result.diagnosis.verdict not in ("unexplained", "partly_explained"):
        return ()
    joint = int(np.argmax(result.account.missed))
    missed, depends = result.account.missed[joint], result.account.depends[joint]
    if missed <= 0:
        return ()
    wanted = next(begin for word, begin in _ISOLATING if word in depends)
    return _of_kind(wanted, menu, joint, size=np.sqrt(missed))


def _for_unforetold(result: Result, menu: Menu) -> tuple[Plan, ...]:
    """A wide motion, if logs are explained but do not foretell held-out motion."""
    # The values of the causes are not well known then, and other motion tells them.
    unseen = result.diagnosis.unseen
    if unseen is None or not result.diagnosis.findings:
        return ()
    left = np.nan_to_num(unseen.named)  # NaN where a joint does not move
    over = left / np.maximum(unseen.noise, 1e-300)
    joint = int(np.argmax(over))
    if over[joint] <= ABOVE:
        return ()
    text = _TOGETHER.format(result.diagnosis.joints[joint])
    return _of_kind(_WIDE, menu, joint, more=text)


def _of_kind(
    wanted: str, menu: Menu, joint: int, *, size: float = 0.0, more: str = ""
) -> tuple[Plan, ...]:
    """The first experiment about a joint whose name starts as wanted, if there is."""
    found = (x for x in menu.about(joint) if x.name.startswith(wanted))
    return tuple(_plan(x, (), size, more) for x in islice(found, 1))


def _for_not_excited(result: Result, menu: Menu) -> Iterator[Plan]:
    """A ladder of speeds for joints that did not move, or in one direction only."""
    said = result.diagnosis.not_excited
    still = [
        j for j, name in enumerate(result.gap.robot.joints)
        if name in said
        or any(x.startswith((f"{name} does", f"{name} moving")) for x in said)
    ]  # fmt: skip
    return islice((_plan(x) for j in still for x in menu.ladder(j)), _MOST_JOINTS)


def _for_servos(result: Result, menu: Menu) -> Iterator[Plan]:
    """A run with other servo gains, if findings of a servo are not distinguished."""
    for finding in result.diagnosis.findings:
        ids = finding.alternatives
        if len(ids) > 1 and effect_class(ids[0]).port is Port.COMMAND:
            yield from (_plan(x, ids) for x in menu.of_all_joints if x.gains)


def _plan(
    x: Experiment, splits: tuple[str, ...] = (), size: float = 0.0, more: str = ""
) -> Plan:
    return Plan(Advice(_run(x) + more, splits, float(size)), x)


def _run(experiment: Experiment) -> str:
    return f"run {experiment.name} ({experiment.reference.t[-1]:.0f} s)"
