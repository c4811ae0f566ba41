"""Servos fitted to logs without torque, and what is wrong with those of the file.

Explanations compete by their evidence, see :mod:`hybrid.servo.explain`. A number of the
file is wrong with probability 1/(1 + e^−l), where l is the evidence lost with it back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, PLAIN, QUANTITIES, Drive, known_masses
from hybrid.servo.explain import Explanation, Search
from hybrid.servo.finding import ServoFinding
from hybrid.servo.fit import Estimate, Problem
from hybrid.servo.noise import resolution
from hybrid.servo.replay import ServoReplay
from hybrid.servo.simulator import ServoSimulator, converged, missed
from hybrid.servo.start import best_start, first_guess
from hybrid.servo.stretch import Stretch, chosen, stretches_of
from hybrid.shown import Shown
from hybrid.threads import one_thread

_SECONDS, _EACH = 60.0, 10.0  # s of motion to fit, and of a part of it
_TURNS = 20  # Gauss–Newton steps of a plain fit
_NEAR = 3  # causes of a joint, up to which the file is looked at before a plain fit
_WEIGHED = 120.0  # s of unseen motion, on which single numbers are weighed
_UNSEEN = 4  # one recording in so many is kept aside
_TAIL = 0.3  # of a single recording is kept aside
_UNKNOWN = 4.0  # times the resolution of the encoder: more has a cause
_STILL = 3.0  # steps of the encoder: a joint that goes less far rests


@dataclass(frozen=True, eq=False)
class ServoFit(Shown):
    """Servos of an arm, from logs of command and position.

    Attributes:
        robot: The arm as its file has it.
        drive: Servos as found.
        plain_drive: Servos of a plain fit.
        std: Standard deviations: relative of positive numbers, else in the number's
            unit; shape (len(QUANTITIES), n).
        findings: What the file has wrong, the most worthy first.
        before: Error of replays with the file, RMS on unseen motion, (n,), [rad].
        plain: The same with a plain fit of stiffness, damping, friction, rotor, offset
            and delay.
        after: The same with these servos.
        floor: Resolution of the encoder, shape (n,), [rad]: no replay gets below.
        seconds: Unseen motion that was replayed, [s].
        unseen: Where it is from.
        resting: Joints that no log moves; their numbers are the file's.
        scale: Joints whose links have a known mass, on which all torques rest; none if
            they rest on the file's masses.
        notes: What these logs cannot tell.
    """

    robot: Robot
    drive: Drive
    plain_drive: Drive
    std: Array
    findings: tuple[ServoFinding, ...]
    before: Array
    plain: Array
    after: Array
    floor: Array
    seconds: float
    unseen: tuple[str, ...]
    resting: tuple[str, ...]
    scale: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        moving = [k for k, x in enumerate(self.robot.joints) if x not in self.resting]
        before, after = (
            1000 * float(x[moving].mean()) for x in (self.before, self.after)
        )
        names = list(dict.fromkeys(f"{x.quantity} at {x.joint}" for x in self.findings))
        shown = ", ".join(names[:4]) + (
            f" and {len(names) - 4} more" if len(names) > 4 else ""
        )
        cause = f"the file is wrong in {shown}" if names else "nothing stands out"
        text = (
            f"Replays of unseen motion miss by {after:.1f} instead of {before:.1f} "
            f"mrad (mean of joints): {cause}."
        )
        worst = max(moving, key=lambda j: self.after[j])
        joint = self.robot.joints[worst]
        left, floor = 1000 * self.after[worst], 1000 * self.floor[worst]
        if left < _UNKNOWN * floor:
            return text
        return (
            f"{text} Most is left at {joint}: {left:.1f} mrad have no known cause "
            f"(encoder: {floor:.2f})."
        )

    def replayed(self, recording: Recording) -> ServoReplay:
        """A log, and what the file's servos and these make of its commands.

        Args:
            recording: Log with command; its longest stretch without holes is taken.
        """
        whole = stretches_of([recording.in_order(self.robot.joints)])
        longest = max(whole, key=lambda x: x.duration)
        simulator = ServoSimulator(self.robot)
        (before,), (after,) = simulator.replay([longest], [None]) + simulator.replay(
            [longest], [self.drive]
        )
        t = np.arange(len(longest.q), dtype=np.float64) * longest.step
        return ServoReplay(t, longest.command, longest.q, before, after, longest.source)

    def save(self, path: str | Path) -> None:
        """Write the robot's own file with these servos, as MJCF."""
        from hybrid.servo.write import write_servos

        write_servos(self.robot, self.drive, path)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        joints = self.robot.joints
        return {
            "schema": "hybrid.servo/1",
            "robot": self.robot.name,
            "joints": list(joints),
            "sentence": self.sentence,
            "gap": [
                {
                    "joint": joint,
                    "unit": "rad",
                    "before": float(self.before[j]),
                    "plain_fit": float(self.plain[j]),
                    "after": float(self.after[j]),
                    "noise": float(self.floor[j]),
                }
                for j, joint in enumerate(joints)
            ],
            "findings": [asdict(x) for x in self.findings],
            "servos": [
                {
                    "joint": joint,
                    **{
                        x.name: {
                            "value": float(self.drive[x.name][j]),
                            "std": float(self.std[k, j]),
                            "relative": x.positive,
                            "unit": x.unit,
                        }
                        for k, x in enumerate(QUANTITIES)
                    },
                }
                for j, joint in enumerate(joints)
            ],
            "seconds": self.seconds,
            "unseen": [Path(x).name for x in self.unseen],
            "resting": list(self.resting),
            "scale": list(self.scale) or "masses of the file",
            "notes": list(self.notes),
        }


@one_thread
def fit_servo(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    known_mass: Mapping[str, float] | None = None,
    without: Sequence[tuple[int, int]] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> ServoFit:
    """Fit the servos of an arm to logs of command and position.

    Whole recordings are kept aside and replayed at the end; of one or two recordings,
    their last third.

    Args:
        robot: The arm; its servos are where the prior is.
        recordings: Logs with command; torque is not used.
        known_mass: Mass of the link that a joint moves, by the joint's name, [kg]. It
            sets the scale of all torques: without one that is the file's masses.
        without: Numbers known to be right: index of the quantity, and of the joint.
        progress: Is told what is done.

    Raises:
        RecordingError: A log has no command, or no joint moves.
        RobotError: A mass is known of a link that is not there.
    """
    known = known_mass or {}
    masses = known_masses(robot, known)
    struck = [*without, *((NAMES.index("mass"), robot.joints.index(x)) for x in known)]
    logs = stretches_of([x.in_order(robot.joints) for x in recordings])
    learn, unseen = _split(logs)
    rests = _resting(learn)
    if len(rests) == robot.size:
        raise RecordingError("no joint moves; valid are logs of a moving arm")
    prior, floor = Drive.declared(robot).at(mass=masses), resolution(logs)
    moving = ~np.isin(np.arange(robot.size), rests)
    parts = chosen(learn, _SECONDS, _EACH)
    start = best_start(
        ServoSimulator(robot), parts, first_guess(robot, learn, prior), prior
    )
    start = Drive(np.where(moving, start.values, prior.values), prior.stall)
    problem = Problem(converged(robot, parts, start, floor), parts, prior)
    progress("servos: plain fit")
    simple = moving & np.isin(NAMES, PLAIN)[:, None]
    plain = problem.fitted(problem.at(start.coordinates, simple), None, _TURNS)
    search = Search(
        problem, plain.errors, moving, struck, hint=plain.x, progress=progress
    )
    best = _best(search, plain, simple)
    found = problem.prior.moved(best.found.x)
    simulator = problem.simulator
    (before,) = missed(simulator, unseen, [None])
    between, after = missed(simulator, unseen, [prior.moved(plain.x), found])
    std = np.zeros_like(prior.values)
    covariance = problem.covariance(best.found, search.noise)
    std[best.found.free] = np.sqrt(np.diagonal(covariance))
    return ServoFit(
        robot=robot,
        drive=found,
        plain_drive=prior.moved(plain.x),
        std=std,
        findings=_findings(robot, prior, best, std, simulator, unseen),
        before=before,
        plain=between,
        after=after,
        floor=floor,
        seconds=sum(x.duration for x in unseen),
        unseen=tuple(x.source for x in unseen),
        resting=tuple(robot.joints[j] for j in rests),
        scale=tuple(known),
        notes=_notes(robot, rests, known),
    )


def _best(search: Search, plain: Estimate, simple: NDArray[np.bool_]) -> Explanation:
    """The best explanation of each joint, from the file or from a plain fit."""
    near = search.grown(search.file(), _NEAR)
    far = search.of(plain.x, simple & search.allowed)
    noise = search.noise.reaching(np.minimum(near.found.rms, far.found.rms))
    better = search.evidence(far, noise) > search.evidence(near, noise)
    if not better.any():
        return search.pruned(search.grown(near))
    x = np.where(better, far.found.x, near.found.x)
    mixed = search.of(x, np.where(better, far.causes, near.causes))
    return search.pruned(search.grown(replace(mixed, equals=near.equals)))


def _split(logs: list[Stretch]) -> tuple[list[Stretch], list[Stretch]]:
    """What is fitted, and what is kept aside."""
    if len(logs) >= 3:
        unseen = logs[_UNSEEN // 2 :: _UNSEEN]
        return [x for x in logs if x not in unseen], unseen
    ends = [int((1 - _TAIL) * len(x.q)) for x in logs]
    pairs = list(zip(logs, ends, strict=True))
    return [x.cut(0, k) for x, k in pairs], [x.cut(k, len(x.q)) for x, k in pairs]


def _resting(logs: Sequence[Stretch]) -> list[int]:
    travel = np.array([np.ptp(x.q, axis=0) for x in logs]).max(axis=0)
    least = np.maximum(_STILL * np.sqrt(12.0) * resolution(logs), 1e-3)
    return [int(j) for j in np.flatnonzero(travel < least)]


def _findings(
    robot: Robot,
    prior: Drive,
    best: Explanation,
    std: Array,
    simulator: ServoSimulator,
    unseen: Sequence[Stretch],
) -> tuple[ServoFinding, ...]:
    """Numbers without which the logs are less probable, by what they are worth."""
    x, file = best.found.x, prior.coordinates
    places = np.argwhere(best.causes).tolist()
    alone = [prior.moved(_with(x, file, k, j)) for k, j in places]
    parts = chosen(unseen, _WEIGHED, _EACH)
    errors = missed(simulator, parts, [prior.moved(x), *alone])
    findings = []
    for (k, j), error in zip(places, errors[1:], strict=True):
        quantity, off = QUANTITIES[k], 1.96 * std[k, j]
        ends = x[k, j] - off, x[k, j] + off
        low, high = map(float, np.exp(ends) if quantity.positive else ends)
        findings.append(
            ServoFinding(
                effect=quantity.effect,
                joint=robot.joints[j],
                quantity=quantity.name,
                unit=quantity.unit,
                file=float(prior.values[k, j]),
                value=float(prior.moved(x).values[k, j]),
                interval=(low, high),
                probability=float(1.0 / (1.0 + np.exp(-best.losses[k, j]))),
                equivalents=tuple(
                    QUANTITIES[i].effect for i in best.equals.get((k, j), ())
                ),
                worth=float((error - errors[0])[j]),
            )
        )
    return tuple(sorted(findings, key=lambda f: -f.worth))


def _with(x: Array, file: Array, k: int, j: int) -> Array:
    changed = x.copy()
    changed[k, j] = file[k, j]
    return changed


def _notes(
    robot: Robot, rests: Sequence[int], known: Mapping[str, float]
) -> tuple[str, ...]:
    masses = ", ".join(f"{x:g} kg behind {name}" for name, x in known.items())
    notes = [
        f"torques are to the scale of a known mass: {masses}"
        if known
        else "without torque, every torque here rests on the masses of the file: if "
        "these are off by a factor, so are stiffness, damping, friction and rotors"
    ]
    if not robot.chain.inertial[:, 0].any() or not robot.chain.gravity.any():
        notes = ["the file has no weight: only ratios of these numbers are known"]
    if rests:
        names = ", ".join(robot.joints[j] for j in rests)
        notes.append(f"no log moves {names}: their numbers are the file's")
    if not np.isfinite(robot.kp).all():
        notes.append(
            "the file declares no servo at some joints: a position servo is assumed"
        )
    return tuple(notes)
