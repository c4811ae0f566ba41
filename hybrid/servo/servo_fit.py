"""The result of a fit of servos: parameters, findings and replay errors."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.servo.drive import QUANTITIES, Drive
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch, stretches_of
from hybrid.servo.write import write_servos
from hybrid.shown import Shown

_UNKNOWN = 4.0  # times the resolution of the encoder: a larger error has a cause
_MOST_LEFT = 3  # joints in a sentence


@dataclass(frozen=True)
class ServoFinding:
    """One parameter to which the logs give another value than the file.

    Attributes:
        effect: Effect of the library.
        joint: Name of the joint.
        quantity: Name of the parameter.
        unit: Its unit.
        file: Value in the file.
        value: Value by the logs.
        interval: Its 95 % interval.
        probability: Probability that the file is wrong in this parameter.
        equivalents: Effects at the same joint that replay these logs equally well.
        worth: Increase of the replay error on held-out motion with the file's value, at
            this joint or, if it moves several, at the joint with the most, [rad].
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
    """One log of N samples and its replays.

    Attributes:
        t: Time, shape (N,), [s].
        command: Commanded position, shape (N, n), [rad].
        q: Measured position, shape (N, n), [rad].
        before: Replay with the servos of the file, shape (N, n), [rad].
        after: Replay with the servos found, shape (N, n), [rad].
        source: The log.
    """

    t: Array
    command: Array
    q: Array
    before: Array
    after: Array
    source: str


@dataclass(frozen=True, eq=False, repr=False)
class ServoFit(Shown):
    """Servos of an arm, from logs of command and position.

    Attributes:
        robot: The arm by its file.
        drive: Servos found.
        written: The best servos that MJCF can express.
        plain_drive: Servos of the plain fit.
        std: Standard deviations, relative for positive quantities, else in their unit;
            shape (len(QUANTITIES), n).
        findings: Parameters whose value in the file is outside their interval, the
            most important first.
        before: RMS replay error on held-out motion with the file, shape (n,), [rad].
        plain: The same with the plain fit of stiffness, damping, friction, rotor,
            offset and delay.
        after: The same with the servos found.
        floor: Resolution of the encoder, a lower bound of errors, shape (n,), [rad].
        seconds: Length of the held-out motion, [s].
        unseen: Its logs.
        motion: Its longest stretch.
        asked: Lowest and highest command of all logs, shape (2, n), [rad].
        resting: Joints that no log moves; they keep the values of the file.
        scale: Joints whose links have a known mass, which sets the scale of all
            torques; none if the masses of the file do.
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
    motion: Stretch
    asked: Array
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
        each = ((x.quantity.replace("_", " "), x.joint) for x in self.findings)
        names = [f"{quantity} at {joint}" for quantity, joint in dict.fromkeys(each)]
        shown = ", ".join(names[:4]) + (
            f" and {len(names) - 4} more" if len(names) > 4 else ""
        )
        cause = f"the file is wrong in {shown}" if names else "nothing stands out"
        text = (
            f"Replays of unseen motion miss by {after:.1f} instead of {before:.1f} "
            f"mrad (mean of joints that move): {cause}."
        )
        left = [j for j in moving if self.after[j] >= _UNKNOWN * self.floor[j]]
        if not left:
            return text
        left.sort(key=lambda j: -self.after[j])
        places = ", ".join(
            f"{1000 * self.after[j]:.1f} mrad at {self.robot.joints[j]} "
            f"(encoder: {1000 * self.floor[j]:.2f})"
            for j in left[:_MOST_LEFT]
        )
        more = len(left) - _MOST_LEFT
        tail = f" and {more} more" if more > 0 else ""
        return f"{text} Left without a known cause: {places}{tail}."

    def replayed(self, recording: Recording | None = None) -> ServoReplay:
        """Replay a motion with the servos of the file and with these.

        Args:
            recording: Log with command, of which the longest stretch without holes is
                used; the longest held-out motion by default.
        """
        longest = self.motion
        if recording is not None:
            whole = stretches_of([recording.in_order(self.robot.joints)])
            longest = max(whole, key=lambda x: x.duration)
        simulator = ServoSimulator(self.robot)
        (before,), (after,) = simulator.replay([longest], [None]) + simulator.replay(
            [longest], [self.drive]
        )
        t = np.arange(len(longest.q), dtype=np.float64) * longest.step
        return ServoReplay(t, longest.command, longest.q, before, after, longest.source)

    def save(self, path: str | Path) -> None:
        """Write the robot's own file with these servos, as far as MJCF can express.

        Raises:
            HybridError: The path does not end in ``.xml`` or ``.mjcf``.
        """
        if Path(path).suffix.lower() not in (".xml", ".mjcf"):
            raise HybridError(f"{path}: an arm with servos is saved as .xml")
        write_servos(self.robot, self.written, path, self.asked)

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
                {"joint": joint, "unit": self.robot.chain.unit_at([j], "rad")}
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
        return {
            x.name: {
                "value": float(self.drive[x.name][j]),
                "std": float(self.std[k, j]),
                "relative": x.positive,
                "unit": self.robot.chain.unit_at([] if x.shared else [j], x.unit),
            }
            for k, x in enumerate(QUANTITIES)
        }
