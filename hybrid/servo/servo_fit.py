"""Servos fitted to logs without torque, and what is wrong with those of the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.drive import QUANTITIES, Drive
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import stretches_of
from hybrid.shown import Shown

_UNKNOWN = 4.0  # times the resolution of the encoder: more has a cause


@dataclass(frozen=True)
class ServoFinding:
    """One number of the file that is wrong.

    Attributes:
        effect: Effect of the library.
        joint: Name of the joint.
        quantity: What is wrong.
        unit: Its unit.
        file: What the file says.
        value: What the logs say.
        interval: 95 % of the posterior.
        probability: That the file is wrong in this.
        equivalents: Effects at the same joint that replay these logs as well.
        worth: Error of unseen replays that comes back with the file's number, [rad]:
            of this joint; of what moves several joints, at the one that it moves most.
    """

    effect: str
    joint: str
    quantity: str
    unit: str
    file: float
    value: float
    interval: tuple[float, float]
    probability: float
    equivalents: tuple[str, ...]
    worth: float


@dataclass(frozen=True, eq=False)
class ServoReplay:
    """One log beside its replays, N samples.

    Attributes:
        t: Time, shape (N,), [s].
        command: Commanded position, shape (N, n), [rad].
        q: Measured position, shape (N, n), [rad].
        before: What the file's servos make of it, shape (N, n), [rad].
        after: What the servos found make of it, shape (N, n), [rad].
        source: Where the log is from.
    """

    t: Array
    command: Array
    q: Array
    before: Array
    after: Array
    source: str


@dataclass(frozen=True, eq=False)
class ServoFit(Shown):
    """Servos of an arm, from logs of command and position.

    Attributes:
        robot: The arm as its file has it.
        drive: Servos as found.
        written: The same without what MJCF has no place for, others making up for it.
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
    written: Drive
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
        """Write the robot's own file with these servos, as far as MJCF can say them."""
        from hybrid.servo.write import write_servos

        write_servos(self.robot, self.written, path)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        joints = self.robot.joints
        errors = {
            "before": self.before,
            "plain_fit": self.plain,
            "after": self.after,
            "noise": self.floor,
        }
        return {
            "schema": "hybrid.servo/1",
            "robot": self.robot.name,
            "joints": list(joints),
            "sentence": self.sentence,
            "gap": [
                {"joint": joint, "unit": "rad"}
                | {name: float(x[j]) for name, x in errors.items()}
                for j, joint in enumerate(joints)
            ],
            "findings": [asdict(x) for x in self.findings],
            "servos": [
                {"joint": joint} | self._numbers(j) for j, joint in enumerate(joints)
            ],
            "seconds": self.seconds,
            "unseen": [Path(x).name for x in self.unseen],
            "resting": list(self.resting),
            "scale": list(self.scale) or "masses of the file",
            "notes": list(self.notes),
        }

    def _numbers(self, j: int) -> dict[str, Any]:
        """All numbers of one servo."""
        return {
            x.name: {
                "value": float(self.drive[x.name][j]),
                "std": float(self.std[k, j]),
                "relative": x.positive,
                "unit": x.unit,
            }
            for k, x in enumerate(QUANTITIES)
        }
