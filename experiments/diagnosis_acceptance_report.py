"""Scores, table and summary of ``diagnosis_acceptance.py``; it prints nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.diagnosis.answer.diagnosis import Diagnosis
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
        quiet: Whether torque noise is a tenth of the usual.
        effects: The effects that it has.
        diagnosis: What was found.
        rms: Torque gap on the held-out motion, at the joints with effects or at all
            where there are none, by what the simulator has: ``before``, ``after``,
            ``floor``, perhaps ``sysid``, [N·m].
        seconds: Processor time of the diagnosis in torque, and of its replay.
        fitted: A fit of fixed structure to the same log.
    """

    kind: str
    seed: int
    quiet: bool
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
        return float(1 - after / before) if before > 0 else float("nan")

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
            "quiet": self.quiet,
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
              "above floor", "CPU s")  # fmt: skip
    beside = any(x.fitted for x in runs)
    header += ("sysid: after", "removed", "CPU s") if beside else ()
    rows = []
    for x in runs:
        order = {name: str(k) for k, name in enumerate(x.diagnosis.joints)}
        named = [
            f"{f.effect} {','.join(sorted(order[j] for j in f.joints))}"
            for f in x.diagnosis.findings
        ]
        row = [
            f"{x.kind}, {x.seed}{', quiet' if x.quiet else ''}",
            "; ".join(named) or x.diagnosis.verdict,
        ]
        row += [f"{x.rms[k]:.3f}" for k in ("before", "after", "floor")]
        cut = [x.removed("after", above_floor=b) for b in (False, True)]
        row += [f"{c:.1%}" if x.effects else "" for c in cut]
        row += [f"{sum(x.seconds):.1f}"]
        if x.fitted is not None:
            row += [
                f"{x.rms['sysid']:.3f}",
                f"{x.removed('sysid', above_floor=False):.1%}" if x.effects else "",
                f"{x.fitted.seconds:.0f}",
            ]
        rows.append((*row, *[""] * (len(header) - len(row))))
    caption = "RMS torque gap on a held-out motion at the joints with effects, N·m"
    return Table(header, tuple(rows), caption)


def summary(runs: Sequence[Run]) -> list[str]:
    """What it comes to, plant by plant."""
    lines = []
    for kind, quiet in dict.fromkeys((x.kind, x.quiet) for x in runs):
        own = [x for x in runs if (x.kind, x.quiet) == (kind, quiet)]
        head = f"{kind}{', a tenth of the noise' if quiet else ''}: "
        right = sum(x.places == x.true_places for x in own)
        missed = sum(len(x.true_places - x.places) for x in own)
        false = sum(len(x.places - x.true_places) for x in own)
        text = (
            f"exactly what is there is named in {right} of {len(own)} (places missed "
        )
        text += f"{missed}, named without cause {false})"
        if own[0].effects:
            for above, words in ((False, "gap removed"), (True, "above the floor")):
                cut = [x.removed("after", above_floor=above) for x in own]
                text += f"; {words}: median {np.median(cut):.1%}, least {min(cut):.1%}"
            floor = [x.removed("floor", above_floor=False) for x in own]
            text += f"; the plant's own effects remove {np.median(floor):.1%}"
        torque, replay = np.median([x.seconds for x in own], axis=0)
        text += f"; {torque:.1f} s of processor time, {replay:.1f} s to replay"
        lines.append(f"{head}{text}")
        fits = [x.fitted for x in own if x.fitted is not None]
        if fits:
            lines.append(f"{head}{_fixed_structure(own, fits)}")
    return lines


def _fixed_structure(runs: Sequence[Run], fits: Sequence[Fitted]) -> str:
    """What the fit of fixed structure comes to on one kind of plant."""
    seconds = [x.seconds for x in fits]
    text = (
        f"mujoco.sysid takes {min(seconds):.0f} to {max(seconds):.0f} s of processor "
    )
    text += "time"
    joints = runs[0].diagnosis.joints
    touched = {joints[e.joints[0]] for e in runs[0].effects}
    for own, words in ((True, "joints with an effect"), (False, "the other joints")):
        here = [[(j in touched) == own for _, j in x.fit.names] for x in fits]
        wrong = np.concatenate([x.wrong[h] for x, h in zip(fits, here, strict=True)])
        inside = np.concatenate([x.inside[h] for x, h in zip(fits, here, strict=True)])
        if len(wrong):
            text += (
                f"; its numbers of {words} are off by {np.median(wrong):.1%} in the "
            )
            text += f"median and {wrong.max():.0%} at most, {inside.sum()} of "
            text += f"{inside.size} true ones lie in its 95 % intervals"
    if runs[0].effects:
        cut = [x.removed("sysid", above_floor=False) for x in runs]
        text += f"; it removes {np.median(cut):.1%} of the gap in the median"
    return text
