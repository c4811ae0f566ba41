"""The answer: where the gap lies, which effects cause it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from hybrid.diagnosis.answer.events import Event
from hybrid.files import write_json
from hybrid.shown import Shown

SCHEMA = "hybrid.diagnosis/1"

Verdict = Literal[
    "no_gap", "explained", "partly_explained", "unexplained", "not_excited"
]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Region:
    """A part of the gap: one joint over a range of some variable.

    Attributes:
        joint: Its name.
        variable: What the region is a range of.
        low: Lower end.
        high: Upper end.
        unit: Their unit.
        share: Share of the whole gap's squares, each joint in units of its noise.
        interval: 95 % interval of the share, over blocks of time.
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
        joint: Where.
        name: Field's standard term.
        value: Estimate.
        unit: SI unit.
        interval: 95 % interval; both ends the same for a shape that was only chosen.
        determined: Whether the recordings say more of it than was known without them.
    """

    joint: str
    name: str
    value: float
    unit: str
    interval: Interval
    determined: bool = True


@dataclass(frozen=True)
class Shrink:
    """A gap before and after an effect is added, on motions that no step has seen.

    Attributes:
        before: RMS without it.
        after: RMS with it.
        removed: 1 − after/before.
        interval: 95 % interval of ``removed``, over blocks of time.
        horizon_s: Length of the replay, [s]; nothing for torque.
        unit: Of both; as at turning joints where some slide.
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
        effect: Its id.
        joints: Where it acts.
        alternatives: Ids that explain the recordings as well, itself first.
        share: Its part of what is explained (Shapley), 0 to 1.
        parameters: What was fitted.
        shrink: The gap in ``torque`` and in ``motion`` at its joints,
            before and after.
        sentence: What it means, in plain words.
        remedy: What can be done about it.
    """

    effect: str
    joints: tuple[str, ...]
    alternatives: tuple[str, ...]
    share: float
    parameters: tuple[Value, ...]
    shrink: Mapping[str, Shrink]
    sentence: str
    remedy: str


@dataclass(frozen=True)
class Advice:
    """An experiment that would tell remaining candidates apart.

    Attributes:
        experiment: What to run.
        splits: Ids of effects that it tells apart.
        separation: Expected difference of their predictions, in units of noise.
        file: The reference to run, if one was written.
    """

    experiment: str
    splits: tuple[str, ...]
    separation: float
    file: str = ""


@dataclass(frozen=True)
class Unseen:
    """The gap on motions that no step has seen, by joint: RMS, shape (n,), [N·m].

    Not a number where a joint does not move there.

    Attributes:
        before: As the simulator's file stands.
        after: With what was found.
        least_squares: With inertia and friction of all joints fitted by least squares
            to the samples learnt from.
        ceiling: With the unknown laws as well.
        noise: What no model could remove.
    """

    before: tuple[float, ...]
    after: tuple[float, ...]
    least_squares: tuple[float, ...]
    ceiling: tuple[float, ...]
    noise: tuple[float, ...]


@dataclass(frozen=True)
class Diagnosis(Shown):
    """What a simulator lacks.

    Attributes:
        robot: Name of the simulator.
        joints: Its joints.
        rms: Gap of each joint as the simulator stands, in :attr:`units`; 0 of a joint
            that does not move, of which nothing is known.
        relative: The same over the RMS of measured torque.
        noise_floor: What no model could remove, in the same.
        where: Parts of the gap, largest first.
        findings: Effects, largest share first.
        verdict: What it comes to.
        unexplained: Share of the explainable gap that no finding explains.
        background: How far off the simulator's own numbers are everywhere, as one
            standard deviation.
        units: N·m or N, by joint.
        not_excited: What the recordings cannot tell.
        advice: What to run next.
        warnings: What a user should know.
        provenance: Versions, seeds and files.
        unseen: The gap of each joint on motions that no step has seen.
        events: Pushes while the arm stood still.
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

    def save(self, path: str | Path) -> None:
        """Write it to a JSON file."""
        write_json(path, self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content in the form of ``hybrid.diagnosis/1``.

        Null where nothing was measured.
        """
        content = _listed(asdict(self))
        gap = {x: content.pop(x) for x in ("rms", "relative", "noise_floor")}
        for name, values in gap.items():
            pairs = zip(values, self.rms, strict=True)
            gap[name] = [x if moved > 0 else None for x, moved in pairs]
        for region in content["where"]:
            names = "variable", "low", "high", "unit"
            region["region"] = {x: region.pop(x) for x in names}
        for finding in content["findings"]:
            finding["class"] = finding.pop("alternatives")
            for shrink in finding["shrink"].values():
                if shrink["horizon_s"] is None:
                    del shrink["horizon_s"]
        gap["units"] = content.pop("units")
        return {"schema": SCHEMA, "gap": gap, **content}


def _listed(x: Any) -> Any:
    """Lists in place of tuples, and nothing in place of what is not a number."""
    if isinstance(x, Mapping):
        return {name: _listed(value) for name, value in x.items()}
    if isinstance(x, (tuple, list)):
        return [_listed(value) for value in x]
    return None if isinstance(x, float) and not isfinite(x) else x
