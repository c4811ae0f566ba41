"""Scores, table and summary of ``diagnosis_acceptance.py``; it prints nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.diagnose.diagnosis import Diagnosis
from hybrid.effects import Effect
from hybrid.report import Table

if TYPE_CHECKING:
    from diagnosis_acceptance_sysid import Fitted


@dataclass(frozen=True)
class Run:
    """One plant with its diagnosis.

    Attributes:
        kind: Id of its effects.
        seed: Of sizes, motions and noise.
        effects: The effects that it has.
        diagnosis: What was found.
        rms: Torque gap on the held-out motion, at the joints with effects, by what the
            simulator has: ``before``, ``after``, ``floor``, perhaps ``sysid``, [N·m].
        seconds: Processor time of the diagnosis in torque, and of its replay.
        fitted: A fit of fixed structure to the same log.
    """

    kind: str
    seed: int
    effects: tuple[Effect, ...]
    diagnosis: Diagnosis
    rms: dict[str, float]
    seconds: tuple[float, float]
    fitted: Fitted | None

    @property
    def places(self) -> set[tuple[str, str]]:
        """Effect and joint of everything that was named."""
        return {(f.effect, j) for f in self.diagnosis.findings for j in f.joints}

    @property
    def true_places(self) -> set[tuple[str, str]]:
        """Effect and joint of everything that is there."""
        return {(e.id, self.diagnosis.joints[e.joints[0]]) for e in self.effects}

    def removed(self, name: str, *, above_floor: bool) -> float:
        """Share of the held-out gap that is gone."""
        floor = self.rms["floor"] if above_floor else 0.0
        before, after = (
            np.sqrt(max(self.rms[k] ** 2 - floor**2, 0.0)) for k in ("before", name)
        )
        return float(1 - after / before)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        removed = {
            name: {
                "rms": self.removed(name, above_floor=False),
                "above_floor": self.removed(name, above_floor=True),
            }
            for name in self.rms
            if name in ("after", "sysid")
        }
        return {
            "plant": self.kind,
            "seed": self.seed,
            "effects": [e.as_dict(self.diagnosis.joints) for e in self.effects],
            "named": sorted(self.places),
            "right": self.places == self.true_places,
            "verdict": self.diagnosis.verdict,
            "held_out_rms": self.rms,
            "removed": removed,
            "cpu_seconds": dict(zip(("torque", "motion"), self.seconds, strict=True)),
            "sysid": None if self.fitted is None else self.fitted.as_dict(),
            "findings": self.diagnosis.as_dict()["findings"],
        }


def table(runs: Sequence[Run]) -> Table:
    """One row for each plant."""
    header = ("plant, seed", "named", "before", "after", "floor", "removed",
              "above the floor", "CPU s, torque + replay")  # fmt: skip
    beside = any(x.fitted for x in runs)
    header += ("sysid: after", "removed", "wrong by", "CPU s") if beside else ()
    rows = []
    for x in runs:
        order = {name: str(k) for k, name in enumerate(x.diagnosis.joints)}
        named = [
            f"{f.effect} {','.join(sorted(order[j] for j in f.joints))}"
            for f in x.diagnosis.findings
        ]
        row = [f"{x.kind}, {x.seed}", "; ".join(named) or x.diagnosis.verdict]
        row += [f"{x.rms[k]:.3f}" for k in ("before", "after", "floor")]
        row += [f"{x.removed('after', above_floor=b):.1%}" for b in (False, True)]
        row += [f"{x.seconds[0]:.1f} + {x.seconds[1]:.1f}"]
        if x.fitted is not None:
            row += [
                f"{x.rms['sysid']:.3f}",
                f"{x.removed('sysid', above_floor=False):.1%}",
                f"{np.median(x.fitted.wrong):.0%}",
                f"{x.fitted.seconds:.0f}",
            ]
        rows.append((*row, *[""] * (len(header) - len(row))))
    caption = "RMS torque gap on a held-out motion at the joints with effects, N·m"
    return Table(header, tuple(rows), caption)


def summary(runs: Sequence[Run]) -> list[str]:
    """What it comes to."""
    right = sum(x.places == x.true_places for x in runs)
    first = sum(
        bool(x.diagnosis.findings) and x.diagnosis.findings[0].effect == x.kind
        for x in runs
    )
    missed = sum(len(x.true_places - x.places) for x in runs)
    false = sum(len(x.places - x.true_places) for x in runs)
    lines = [
        f"exactly the effects that are there, at exactly their joints: {right} of "
        f"{len(runs)}; the right effect first: {first}; places missed: {missed}, named "
        f"without cause: {false}"
    ]
    for above in (False, True):
        cut = [x.removed("after", above_floor=above) for x in runs]
        lines.append(
            f"gap removed{' above the floor' if above else ''}: median "
            f"{np.median(cut):.1%}, least {min(cut):.1%}"
        )
    floor = [x.removed("floor", above_floor=False) for x in runs]
    lines.append(
        f"the plant's own effects remove {np.median(floor):.1%} in the median, "
        f"{min(floor):.1%} at least"
    )
    torque, replay = np.median([x.seconds for x in runs], axis=0)
    lines.append(f"processor time, median: {torque:.1f} s, and {replay:.1f} s to replay")
    fits = [x.fitted for x in runs if x.fitted is not None]
    if fits:
        seconds = [x.seconds for x in fits]
        wrong = np.concatenate([x.wrong for x in fits])
        inside = np.concatenate([x.inside for x in fits])
        cut = [x.removed("sysid", above_floor=False) for x in runs if x.fitted]
        lines.append(
            f"mujoco.sysid: {min(seconds):.0f} to {max(seconds):.0f} s; its numbers are "
            f"off by {np.median(wrong):.0%} in the median, {inside.sum()} of "
            f"{inside.size} true ones lie in its 95 % intervals; it removes "
            f"{np.median(cut):.1%} of the gap in the median"
        )
    return lines
