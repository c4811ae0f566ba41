"""One number of a robot file that logs contradict."""

from __future__ import annotations

from dataclasses import dataclass


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
        worth: Error of unseen replays of this joint that comes back with the file's
            number, the others making up for it as far as they can, [rad].
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
