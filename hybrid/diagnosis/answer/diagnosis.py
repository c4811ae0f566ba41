"""The answer: where the gap lies, which effects cause it, how far it shrinks."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hybrid.diagnosis.answer.events import Event
from hybrid.diagnosis.prior import Prior
from hybrid.files import write_json
from hybrid.shown import Shown, plain

SCHEMA = "hybrid.diagnosis/2"
ABOVE = 1.2  # times the noise: a smaller gap is not mentioned
EXPLAINED = 0.9  # share of the squares above noise, of a gap that is explained

Verdict = Literal[
    "no_gap", "explained", "partly_explained", "unexplained", "not_excited"
]
Interval = tuple[float, float]
_BY_JOINT = "rms", "relative", "noise_floor", "units", "unseen"  # in a row of each


@dataclass(frozen=True)
class Region:
    """A part of the gap: one joint over a range of one variable.

    Attributes:
        joint: Name of the joint.
        variable: Name of the variable.
        low: Lower end of the range.
        high: Upper end of the range.
        unit: Unit of both ends.
        share: Share of the squares above noise of the whole gap, in units of each
            joint's noise.
        interval: 95 % interval of the share, by the bootstrap over blocks of time.
    """

    joint: str
    variable: str
    low: float
    high: float
    unit: str
    share: float
    interval: Interval


@dataclass(frozen=True)
class Value:
    """A fitted parameter of an effect at a joint.

    Attributes:
        joint: Name of the joint.
        name: Name of the parameter.
        value: Estimate.
        unit: SI unit.
        interval: 95 % interval; both ends are equal without a standard deviation.
        determined: Whether the recordings narrow the prior, or tell a gain from zero.
    """

    joint: str
    name: str
    value: float
    unit: str
    interval: Interval
    determined: bool = True


@dataclass(frozen=True)
class Shrink:
    """The gap without and with an effect, on held-out motions.

    Attributes:
        before: RMS without it.
        after: RMS with it.
        removed: 1 − after/before.
        interval: 95 % interval of ``removed``, by the bootstrap over blocks of time.
        horizon_s: Length of the replay, [s]; None for torque.
        unit: Unit of ``before`` and ``after``; that of revolute joints where they are
            mixed with prismatic ones.
    """

    before: float
    after: float
    removed: float
    interval: Interval
    horizon_s: float | None = None
    unit: str = "N·m"


@dataclass(frozen=True)
class Finding:
    """One effect that explains part of the gap.

    Attributes:
        effect: Id of the effect.
        joints: Names of the joints where it acts.
        alternatives: Ids of effects that explain as much, its own first.
        share: Share of the explained gap (Shapley value), 0 to 1.
        parameters: Fitted parameters.
        shrink: The gap without and with it at its joints, in ``torque`` and ``motion``.
        sentence: What the effect is, in words.
        remedy: What to do about it.
        chances: Probability of each alternative, mean over its joints; empty where
            none was computed, as for the command.
        probability: Probability that one of them is there, at the joint where it is
            least. The rest is that of other effects, of an unknown law, and of none.
        note: What the values rest on, in words; empty if on the logs alone.
    """

    effect: str
    joints: tuple[str, ...]
    alternatives: tuple[str, ...]
    share: float
    parameters: tuple[Value, ...]
    shrink: Mapping[str, Shrink]
    sentence: str
    remedy: str
    chances: tuple[float, ...] = ()
    probability: float = np.nan
    note: str = ""


@dataclass(frozen=True)
class Advice:
    """An experiment that tells candidate effects apart.

    Attributes:
        experiment: What to run.
        splits: Ids of the effects that it tells apart.
        separation: Expected difference of their predictions, in units of noise.
        file: File name of the reference motion; empty if none was written.
    """

    experiment: str
    splits: tuple[str, ...]
    separation: float
    file: str = ""


@dataclass(frozen=True)
class Unseen:
    """The gap of each joint on held-out motions: RMS, shape (n,), [N·m].

    NaN where a joint does not move.

    Attributes:
        before: Gap of the simulator's file.
        after: Gap of the repaired simulator: with the findings, and with known laws in
            place of unknown ones.
        least_squares: Gap after a least-squares fit of inertia and friction of all
            joints to the training samples.
        ceiling: Gap with the findings and the unknown laws.
        noise: Noise, which no model removes.
        named: Gap with the findings and corrected numbers of the file.
    """

    before: tuple[float, ...]
    after: tuple[float, ...]
    least_squares: tuple[float, ...]
    ceiling: tuple[float, ...]
    noise: tuple[float, ...]
    named: tuple[float, ...]


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """What a simulator lacks.

    Attributes:
        robot: Name of the robot.
        joints: Names of its joints.
        rms: RMS gap of the simulator at each joint, in :attr:`units`; 0 for a joint
            that does not move.
        relative: RMS gap over the RMS of measured torque.
        noise_floor: RMS of the noise, which no model removes, in :attr:`units`.
        where: Parts of the gap, largest first.
        findings: Effects, largest share first.
        verdict: Result in one word.
        unexplained: Share of the gap above noise that no finding explains.
        background: Relative standard deviation of errors of the simulator's numbers.
        units: N·m or N, by joint.
        not_excited: What the recordings do not determine.
        advice: Experiments to run next.
        warnings: Messages for the user.
        doubts: Reasons to doubt the findings.
        provenance: Versions, seeds and files.
        unseen: The gap of each joint on held-out motions.
        events: Contacts of the moving arm, then pushes while it stood still.
        unlike: What of the file is not as in the logs, and so of another arm; empty if
            nothing is.
        sentence: The effects, their joints and what is left, in a few words.
        torque_scale: Logged torque over true torque, by a known mass; None without.
    """

    robot: str
    joints: tuple[str, ...]
    rms: tuple[float, ...]
    relative: tuple[float, ...]
    noise_floor: tuple[float, ...]
    where: tuple[Region, ...]
    findings: tuple[Finding, ...]
    verdict: Verdict
    unexplained: float
    background: float
    units: tuple[str, ...] = ()
    not_excited: tuple[str, ...] = ()
    advice: tuple[Advice, ...] = ()
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    unseen: Unseen | None = None
    events: tuple[Event, ...] = ()
    doubts: tuple[str, ...] = ()
    unlike: str = ""
    sentence: str = ""
    torque_scale: Value | None = None

    @property
    def has_usual_numbers(self) -> bool:
        """Whether errors of the simulator's numbers are as in usual robot files."""
        return self.background <= Prior().file_errors[1]

    def save(self, path: str | Path) -> None:
        """Write the diagnosis to a JSON file."""
        write_json(path, self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content by the schema ``hybrid.diagnosis/2``; NaN becomes None."""
        content = {x: y for x, y in asdict(self).items() if x not in _BY_JOINT}
        for region in content["where"]:
            names = "variable", "low", "high", "unit"
            region["region"] = {x: region.pop(x) for x in names}
        for finding in content["findings"]:
            ids, chances = finding.pop("alternatives"), finding.pop("chances")
            pairs = zip_longest(ids, chances)
            finding["class"] = [{"effect": e, "probability": p} for e, p in pairs]
            for shrink in finding["shrink"].values():
                if shrink["horizon_s"] is None:
                    del shrink["horizon_s"]
        for event in content["events"]:
            event["joints"] = self.joints
        first = {x: content.pop(x) for x in ("robot", "joints", "sentence", "verdict")}
        first["unknown"] = content.pop("unexplained")
        first["gap"] = [*map(self._gap_of, range(len(self.joints)))]
        found: dict[str, Any] = plain({"schema": SCHEMA, **first, **content})
        return found

    def _gap_of(self, joint: int) -> dict[str, Any]:
        """The gap of a joint, and what is left of it."""
        name, moves = self.joints[joint], self.rms[joint] > 0
        row: dict[str, Any] = {
            "joint": name,
            "unit": self.units[joint] if self.units else "N·m",
            "rms": self.rms[joint] if moves else None,
            "relative": self.relative[joint] if moves else None,
        }
        each: dict[str, Any] = dict.fromkeys(x.name for x in fields(Unseen))
        if self.unseen is not None:
            each = {name: getattr(self.unseen, name)[joint] for name in each}
        elif moves:
            each["noise"] = self.noise_floor[joint]
        by = [f.effect for f in self.findings if name in f.joints]
        return row | each | {"explained_by": by, "unknown": self.unknown_at(joint)}

    def unknown_at(self, joint: int) -> float | None:
        """Share of a joint's squares above noise that no finding explains, unseen.

        None if the gap does not stand above the noise.
        """
        if self.unseen is None:
            return None
        before, left, noise = (
            getattr(self.unseen, x)[joint] ** 2 for x in ("before", "named", "noise")
        )
        if not before > ABOVE**2 * noise:
            return None
        return float(np.clip((left - noise) / (before - noise), 0.0, 1.0))


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names in words: ``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"
