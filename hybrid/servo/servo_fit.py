"""Servos fitted to logs without torque, and what is wrong with those of the file.

A number of the file is wrong with probability 1/(1 + e^(cost − log B)): B, the
Savage–Dickey ratio, is the prior density of the file's own number over its posterior
density, and the cost is that of one cause in some hundred places. One guard stays: with
the number put back, and the others making up for it, replays of motion that was not
fitted must be worse by more than a step of the encoder.

Source: Dickey 1971, doi 10.1214/aoms/1177693507.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, PLAIN, QUANTITIES, Drive
from hybrid.servo.finding import ServoFinding
from hybrid.servo.fit import DriveEstimate, fitted, resolution
from hybrid.servo.needed import missed, needed
from hybrid.servo.replay import ServoReplay
from hybrid.servo.simulator import ServoSimulator, converged
from hybrid.servo.start import best_start, first_guess
from hybrid.servo.stretch import Stretch, chosen, stretches_of
from hybrid.shown import Shown
from hybrid.threads import one_thread

_COST = 5.0  # nats: prior odds of one number, among some hundred, to be wrong
_SURE = 0.95
# s of motion to fit, to check, and of a part of either.
_SECONDS, _CHECKED, _EACH = 240.0, 60.0, 10.0
_WEIGHED = 120.0  # s of unseen motion, on which single numbers are weighed
_UNSEEN = 4  # one recording in so many is kept aside
_TAIL = 0.3  # of a single recording is kept aside
_UNKNOWN = 4.0  # times the resolution of the encoder: more has a cause
_STILL = 3.0  # steps of the encoder: a joint that goes less far rests
# Shapes of friction have no number in the file; they are no cause of their own.
_SHAPES = ("stribeck_speed", "bristle")


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
            "notes": list(self.notes),
        }


@one_thread
def fit_servo(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> ServoFit:
    """Fit the servos of an arm to logs of command and position.

    Whole recordings are kept aside and replayed at the end; of one or two recordings,
    their last third.

    Args:
        robot: The arm; its servos are where the prior is.
        recordings: Logs with command; torque is not used.
        progress: Is told what is done.

    Raises:
        RecordingError: A log has no command, or no joint moves.
    """
    logs = stretches_of([x.in_order(robot.joints) for x in recordings])
    learn, unseen = _split(logs)
    rests = _resting(learn)
    if len(rests) == robot.size:
        raise RecordingError("no joint moves; valid are logs of a moving arm")
    prior, floor = Drive.declared(robot), resolution(logs)
    parts = chosen(learn, _SECONDS + _CHECKED, _EACH)
    count = round(len(parts) * _SECONDS / (_SECONDS + _CHECKED))
    parts, others = parts[:count], parts[count:] or parts
    moving = np.ones_like(prior.values, dtype=bool)
    moving[:, rests] = False
    simulator = ServoSimulator(robot)
    start = best_start(simulator, parts, first_guess(robot, learn), prior)
    start = Drive(np.where(moving, start.values, prior.values), prior.stall)
    simulator = converged(robot, others, start, floor)
    search = partial(fitted, simulator, parts, prior=prior)
    simple = moving & np.isin(NAMES, PLAIN)[:, None]
    plain = search(
        start=start, free=simple, progress=lambda text: progress(f"plain {text}")
    )
    whole = search(start=plain.drive, free=moving, progress=progress)
    progress("servos: which numbers of the file can stay")
    # As everywhere, more numbers are taken only if they help on motion not fitted.
    errors = missed(simulator, others, [plain.drive, whole.drive])
    best = int(np.argmin(errors.mean(axis=1)))
    # Where the file replays as well, it stays.
    stays = missed(simulator, others, [None])[0] <= errors[best]
    found = (plain, whole)[best].keeping(prior, stays)
    differs = needed(simulator, others, prior, found, np.sqrt(12.0) * floor)
    (before,) = missed(simulator, unseen, [None])
    between, after = missed(simulator, unseen, [plain.drive, found.drive])
    return ServoFit(
        robot=robot,
        drive=found.drive,
        plain_drive=plain.drive,
        std=found.std,
        findings=_findings(robot, prior, found, differs, simulator, unseen),
        before=before,
        plain=between,
        after=after,
        floor=floor,
        seconds=sum(x.duration for x in unseen),
        unseen=tuple(x.source for x in unseen),
        resting=tuple(robot.joints[j] for j in rests),
        notes=_notes(robot, rests),
    )


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
    found: DriveEstimate,
    differs: NDArray[np.bool_],
    simulator: ServoSimulator,
    unseen: Sequence[Stretch],
) -> tuple[ServoFinding, ...]:
    """Numbers that differ with probability 0.95, and whose file's value is worse."""
    file, x, spread = prior.coordinates, found.drive.coordinates, prior.spread
    std = np.minimum(np.maximum(found.std, 1e-9), spread)
    odds = np.log(spread / std) - 0.5 * ((x - file) / std) ** 2
    probability = 1.0 / (1.0 + np.exp(np.minimum(odds + _COST, 700.0)))
    named = [q.name not in _SHAPES for q in QUANTITIES]
    sure = differs & (probability >= _SURE) & np.array(named)[:, None]
    places = np.argwhere(sure).tolist()
    # Far off, the others that would make up for it are not known: then they stay.
    back = [found.back(prior, k, j) for k, j in places]
    alone = [found.drive.moved(_with(x, file, k, j)) for k, j in places]
    parts = chosen(unseen, _WEIGHED, _EACH)
    errors = missed(simulator, parts, [found.drive, *back, *alone])
    errors[1 : 1 + len(back)] = np.minimum(
        errors[1 : 1 + len(back)], errors[1 + len(back) :]
    )
    findings = []
    for (k, j), error in zip(places, errors[1 : 1 + len(back)], strict=True):
        quantity, off = QUANTITIES[k], 1.96 * std[k, j]
        ends = x[k, j] - off, x[k, j] + off
        low, high = map(float, np.exp(ends) if quantity.positive else ends)
        worth = float(error[j] - errors[0, j])
        if worth > 0:
            findings.append(
                ServoFinding(
                    effect=quantity.effect,
                    joint=robot.joints[j],
                    quantity=quantity.name,
                    unit=quantity.unit,
                    file=float(prior.values[k, j]),
                    value=float(found.drive.values[k, j]),
                    interval=(low, high),
                    probability=float(probability[k, j]),
                    worth=worth,
                )
            )
    return tuple(sorted(findings, key=lambda f: -f.worth))


def _with(x: Array, file: Array, k: int, j: int) -> Array:
    changed = x.copy()
    changed[k, j] = file[k, j]
    return changed


def _notes(robot: Robot, rests: Sequence[int]) -> tuple[str, ...]:
    notes = [
        "without torque, every torque here rests on the masses of the file: if these "
        "are off by a factor, so are stiffness, damping, friction and rotors"
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
