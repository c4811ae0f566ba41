"""Fit servos to logs of command and position by replays.

Explanations compete by their evidence, see :mod:`hybrid.servo.search`. A parameter of
the file is wrong with probability 1/(1 + e^−l), where l is the evidence lost if it goes
back to the file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array, Mask
from hybrid.errors import RecordingError
from hybrid.progress import Progress, silent
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, PLAIN, QUANTITIES, Drive, known_masses
from hybrid.servo.model import heights
from hybrid.servo.noise import resolution
from hybrid.servo.problem import SHARED, Estimate, Problem
from hybrid.servo.search import Search
from hybrid.servo.servo_fit import ServoFinding, ServoFit
from hybrid.servo.simulator import ServoSimulator, converged, missed
from hybrid.servo.start import best_start, first_guess
from hybrid.servo.stretch import Stretch, chosen, stretches_of
from hybrid.servo.write import clipped
from hybrid.threads import one_thread

_SECONDS, _EACH = 60.0, 5.0  # s: motion to fit, and length of its parts
_TURNS = 20  # Gauss–Newton steps of the plain fit
_LAST = 2  # Gauss–Newton steps of the fit to all parts of the logs
_WEIGHED = 120.0  # s: motion set aside in the search
_UNSEEN = 4  # one recording in four is held out
_TAIL = 0.3  # of one or two recordings, this share is held out
_STILL = 3.0  # steps of the encoder: a joint with a smaller range rests


@one_thread
@typed
def fit_servo(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    known_mass: Mapping[str, float] | None = None,
    without: Sequence[tuple[int, int]] = (),
    gpu: bool = False,
    progress: Progress = silent,
) -> ServoFit:
    """Fit the servos of an arm to logs of command and position.

    Whole recordings are held out and replayed at the end; of one or two recordings,
    their last third.

    Args:
        robot: The arm; its servos are the prior.
        recordings: Logs with command; torque is not used.
        known_mass: Mass of the link that a joint moves, by the joint's name, [kg]. It
            sets the scale of all torques: without one that is the file's masses.
        without: Parameters known to be right: index of the quantity, and of the joint.
        gpu: Replay on a GPU.
        progress: Receives each step.

    Raises:
        HybridError: A GPU is asked for, and none is there.
        RecordingError: A log has no command, or no joint moves.
        RobotError: The link of a known mass does not exist.
    """
    logs = [x.in_order(robot.joints) for x in recordings]
    known, simulator = known_mass or {}, ServoSimulator(robot, gpu=gpu)
    prior = Drive.declared(robot).at(mass=known_masses(robot, known))
    struck = [*without, *((NAMES.index("mass"), robot.joints.index(x)) for x in known)]
    whole = stretches_of(logs)
    asked = _ends(np.concatenate([x.sent for x in whole]))
    learn, unseen = _split(whole)
    problem, start = _problem(simulator, learn, prior)
    allowed = np.tile(~problem.resting, (len(NAMES), 1))
    allowed[[x.base for x in QUANTITIES], 1:] = False
    for at in struck:
        allowed[at] = False
    progress("servos: plain fit; the search for causes may take minutes", None)
    x = np.where(allowed, start, prior.coordinates)
    free = np.isin(NAMES, PLAIN)[:, None] & allowed
    plain = problem.fitted(problem.at(x, free), None, _TURNS)
    parts = chosen(learn, _SECONDS + _WEIGHED, _EACH)
    rest = parts[len(problem.stretches) :]
    aside = problem.over(rest) if rest else None
    search = Search(problem, plain, aside, allowed, progress)
    every = problem.over(parts) if rest else problem
    return _result(robot, known, search, every, search.best(), unseen, asked)


def _result(
    robot: Robot,
    known: Mapping[str, float],
    search: Search,
    problem: Problem,
    best: Estimate,
    unseen: Sequence[Stretch],
    asked: Array,
) -> ServoFit:
    """Fit the result to all parts of the logs, and replay the held-out motion."""
    plain, found, written = (
        problem.fitted(replace(x, errors=problem.errors([x.x])[0]), None, _LAST)
        for x in (search.plain, best, _written(search, best))
    )
    simulator, std = problem.simulator, np.zeros_like(problem.prior.values)
    covariance = problem.covariance(found, search.noise)
    std[found.free] = np.sqrt(np.diagonal(covariance))
    drives = [problem.prior.moved(each.x) for each in (plain, found, written)]
    (before,) = missed(simulator, unseen, [None])
    between, after, less = missed(simulator, unseen, drives)
    notes = _notes(robot, problem.resting, known)
    notes += [*_unsaid(robot, drives[1], after, less), *_clips(robot, drives[2], asked)]
    return ServoFit(
        robot=robot,
        drive=drives[1],
        written=drives[2],
        plain_drive=drives[0],
        std=std,
        findings=_findings(robot, problem, found, std, unseen),
        before=before,
        plain=between,
        after=after,
        floor=resolution([*problem.stretches, *unseen]),
        seconds=sum(x.duration for x in unseen),
        unseen=tuple(x.source for x in unseen),
        motion=max(unseen, key=lambda x: x.duration),
        asked=asked,
        resting=tuple(robot.joints[j] for j in np.flatnonzero(problem.resting)),
        scale=tuple(known),
        notes=tuple(notes),
    )


def _problem(
    simulator: ServoSimulator, logs: Sequence[Stretch], prior: Drive
) -> tuple[Problem, Array]:
    """The logs to fit, and the coordinates from which the plain fit starts."""
    robot, floor = simulator.robot, resolution(logs)
    travel = np.array([np.ptp(x.q, axis=0) for x in logs]).max(axis=0)
    resting = travel < np.maximum(_STILL * np.sqrt(12.0) * floor, 1e-3)
    if resting.all():
        raise RecordingError("no joint moves; valid are logs of a moving arm")
    parts, guess = chosen(logs, _SECONDS, _EACH), first_guess(robot, logs, prior)
    start = best_start(simulator, parts, guess, prior)
    start = replace(start, values=np.where(resting, prior.values, start.values))
    simulator = converged(simulator, parts, start, floor)
    reached = _ends(np.concatenate([x.q for x in logs]))
    touched = np.full(robot.size, np.nan)
    if robot.chain.gravity.any():
        low, asked = (
            np.min([heights(robot, x).min(axis=0) for x in each], axis=0)
            for each in ([x.q for x in logs], [x.command for x in logs])
        )
        touched = np.where(asked < low, low, np.nan)
    problem = Problem(simulator, parts, prior, resting, reached, touched)
    return problem, start.coordinates


def _ends(x: Array) -> Array:
    return np.stack([x.min(axis=0), x.max(axis=0)])


def _written(search: Search, best: Estimate) -> Estimate:
    """The most probable servos that MJCF can express."""
    unsaid = np.array([x.unsaid for x in QUANTITIES])[:, None]
    if not (best.causes & unsaid).any():
        return best
    x = np.where(unsaid, search.problem.prior.coordinates, best.x)
    return search.of(x, best.causes & ~unsaid, _LAST)


def _split(logs: list[Stretch]) -> tuple[list[Stretch], list[Stretch]]:
    """Logs to fit, and logs to hold out."""
    if len(logs) >= 3:
        unseen = logs[_UNSEEN // 2 :: _UNSEEN]
        return [x for x in logs if x not in unseen], unseen
    ends = [int((1 - _TAIL) * len(x.q)) for x in logs]
    pairs = list(zip(logs, ends, strict=True))
    return [x.cut(0, k) for x, k in pairs], [x.cut(k, len(x.q)) for x, k in pairs]


def _findings(
    robot: Robot,
    problem: Problem,
    best: Estimate,
    std: Array,
    unseen: Sequence[Stretch],
) -> tuple[ServoFinding, ...]:
    """Causes for which the file is wrong, ordered by their worth on held-out motion."""
    x, prior, findings = best.x, problem.prior, []
    places = np.argwhere(best.causes).tolist()
    alone = [x.copy() for _ in places]
    for (k, j), each in zip(places, alone, strict=True):
        each[k, j] = prior.coordinates[k, j]
    parts = chosen(unseen, _WEIGHED, _EACH)
    drives = [prior.moved(each) for each in (x, *alone)]
    errors = missed(problem.simulator, parts, drives)
    for (k, j), error in zip(places, errors[1:], strict=True):
        quantity, value = QUANTITIES[k], float(drives[0].values[k, j])
        others = best.equals.get((k, j), ())
        finding = ServoFinding(
            effect=quantity.effect,
            joint=robot.joints[j],
            quantity=quantity.name,
            unit=robot.chain.unit_at([] if quantity.shared else [j], quantity.unit),
            file=float(prior.values[k, j]),
            value=value,
            interval=quantity.interval(value, float(std[k, j])),
            probability=float(1.0 / (1.0 + np.exp(-best.losses[k, j]))),
            equivalents=tuple(QUANTITIES[i].effect for i in others),
            worth=float((error - errors[0])[slice(None) if SHARED[k] else j].max()),
        )
        findings.append(finding)
    wrong = [f for f in findings if not f.interval[0] <= f.file <= f.interval[1]]
    return tuple(sorted(wrong, key=lambda f: -f.worth))


def _unsaid(robot: Robot, drive: Drive, after: Array, written: Array) -> list[str]:
    """What the written file cannot express, and what that costs on held-out motion."""
    less = [
        f"{1000 * x:.1f} instead of {1000 * y:.1f}"
        for x, y in zip(written, after, strict=True)
    ]
    found = [
        f"the written file has no ground: the link of {joint} touches one where its "
        f"centre of mass is {height:.3f} m above the base"
        for joint, height, none in zip(
            robot.joints, drive["ground"], Drive.declared(robot)["ground"], strict=True
        )
        if height > none
    ]
    return found + [
        f"MJCF has no place for the {each.name.replace('_', ' ')} of {joint}, "
        f"{f'{drive[each.name][j]:.3g} {each.unit}'.strip()}: replays of a "
        f"written file miss by {less[j]} mrad there"
        for each in QUANTITIES
        for j, joint in enumerate(robot.joints)
        if each.unsaid and drive[each.name][j] > 0
    ]


def _clips(robot: Robot, drive: Drive, asked: Array) -> list[str]:
    """Control ranges that the written file has no longer."""
    if not Path(robot.path).is_file():
        return []
    lost = np.flatnonzero(clipped(robot, drive, asked)).tolist()
    return [
        f"the file's ctrlrange clips commands of {robot.joints[j]}, which go from "
        f"{asked[0, j]:.3g} to {asked[1, j]:.3g} rad in the logs: the written file has "
        "no ctrlrange there"
        for j in lost
    ]


def _notes(robot: Robot, resting: Mask, known: Mapping[str, float]) -> list[str]:
    """What these logs cannot tell."""
    masses = ", ".join(f"{x:g} kg behind {name}" for name, x in known.items())
    notes = [
        f"torques are to the scale of a known mass: {masses}"
        if known
        else "without torque, every torque here rests on the masses of the file: if "
        "these are off by a factor, so are stiffness, damping, friction and rotors"
    ]
    if not robot.chain.inertial[:, 0].any() or not robot.chain.gravity.any():
        notes = ["the file has no weight: only ratios of these numbers are known"]
    if resting.any():
        names = ", ".join(robot.joints[j] for j in np.flatnonzero(resting))
        notes.append(f"no log moves {names}: their numbers are the file's")
    if not np.isfinite(robot.kp).all():
        notes.append(
            "the file declares no servo at some joints: a position servo is assumed"
        )
    return notes
