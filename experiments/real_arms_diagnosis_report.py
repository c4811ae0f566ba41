"""Words, tables and figure of ``real_arms_diagnosis.py``; it prints nothing itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hybrid.diagnosis.answer.diagnosis import Advice, Diagnosis, Finding, Region
from hybrid.diagnosis.answer.result import Result
from hybrid.report import Table, markdown_table
from hybrid.report.style import BLUE, GREY, PALE, RED, clean, legend, new_figure

INKS = {"as the file stands": PALE, "links corrected": GREY, "repaired simulator": BLUE}


@dataclass(frozen=True)
class Score:
    """One arm's diagnosis.

    Attributes:
        arm: Its type.
        diagnosis: The answer.
        held_out: RMS of torque and of its gap on held-out samples, by model, shape
            (n,) each, [N·m].
        unseen: Length of those samples, [s].
        seconds: Processor time of the diagnosis in torque, and of replay and advice.
    """

    arm: str
    diagnosis: Diagnosis
    held_out: dict[str, np.ndarray]
    unseen: float
    seconds: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        return {
            "diagnosis": self.diagnosis.as_dict(),
            "held_out_rms": self.held_out,
            "held_out_seconds": self.unseen,
            "cpu_seconds": dict(zip(("torque", "motion"), self.seconds, strict=True)),
        }


def held_out(result: Result) -> dict[str, np.ndarray]:
    """RMS on samples to which nothing was fitted, shape (n,) each, [N·m].

    They only decided which causes stay.
    """
    scored, search = result.scored, result.search
    alone = np.zeros(len(scored.index))
    background = search.evidence.solve(search.background).gains
    alone[: len(background)] = background
    simulated = np.concatenate([sampler(m.tau) for m, _, sampler in result.gap])
    torque = simulated + result.gap.left
    squares = {
        "torque": [torque[rows, i] for i, rows in enumerate(scored.evidence.rows)],
        "as the file stands": scored.left(np.zeros(len(scored.index))),
        "links corrected": scored.left(alone),
    }
    found = {
        name: np.array([np.sqrt(np.mean(x**2)) if len(x) else np.nan for x in parts])
        for name, parts in squares.items()
    }
    unseen = result.diagnosis.unseen
    assert unseen is not None
    found["repaired simulator"] = np.array(unseen.after)
    return found | {"plain least squares": np.array(unseen.least_squares)}


def said(score: Score) -> str:
    """Verdict and findings as lines."""
    d = score.diagnosis
    head = (
        f"{score.arm}: {d.verdict}, {d.unexplained:.1%} of the explainable gap left; "
        f"{score.seconds[0]:.0f} + {score.seconds[1]:.0f} s of processor time"
    )
    return "\n".join(
        [head, *(" ".join(_cells(f, d)) for f in d.findings), *d.doubts, *d.warnings]
    )


def in_words(score: Score) -> str:
    """All of an arm as Markdown."""
    d = score.diagnosis
    header = ("effect", "cannot be told from", "joints", "share of the explained",
              "torque gap removed, held out", "motion error removed")  # fmt: skip
    found = Table(header, tuple(_cells(f, d) for f in d.findings), words=True)
    text = f"## {score.arm}\n\nVerdict: `{d.verdict}`; {d.unexplained:.1%} of what is "
    text += "explainable at all is left. Processor time "
    text += f"{score.seconds[0]:.0f} s, with replay and advice "
    text += f"{sum(score.seconds):.0f} s.\n\n{markdown_table(found)}\n"
    gaps = gap_table(score)
    text += f"{gaps.caption}.\n\n{markdown_table(gaps)}\n"
    for title, lines in (
        ("Doubts", d.doubts),
        ("Warnings", d.warnings),
        ("Not excited", d.not_excited),
        ("To run next", [*map(_advice, d.advice)]),
        ("Largest parts of the gap", [_place(r) for r in d.where[:5]]),
    ):
        if lines:
            text += f"{title}:\n\n" + "".join(f"- {x}\n" for x in lines) + "\n"
    return text


def _advice(x: Advice) -> str:
    return f"{x.experiment} ({', '.join(x.splits)})" if x.splits else x.experiment


def gap_table(score: Score) -> Table:
    """Torque and its gap, joint by joint, on held-out samples."""
    rows = [
        (name, *(f"{x:.3g}" for x in rms), f"{np.nanmean(rms):.3g}")
        for name, rms in score.held_out.items()
    ]
    floor = score.diagnosis.noise_floor
    rows.append(("noise floor", *(f"{x:.3g}" for x in floor), f"{np.mean(floor):.3g}"))
    before, after = (score.held_out[k] for k in list(INKS)[::2])
    cut = 1 - np.append(after / before, np.nanmean(after) / np.nanmean(before))
    rows.append(("removed", *(f"{x:.0%}" for x in cut)))
    caption = (
        f"{score.arm}: RMS on {score.unseen:.1f} s to which nothing was fitted, N·m"
    )
    numbers = (str(k + 1) for k in range(len(score.diagnosis.joints)))
    return Table(("joint", *numbers, "mean"), tuple(rows), caption)


def gap_figure(score: Score) -> Figure:
    """The gap of each joint before and after, as a share of its torque."""
    figure = new_figure(height=2.8)
    axes = figure.subplots()
    torque, x = score.held_out["torque"], np.arange(len(score.diagnosis.joints))
    clean(axes, grid="y")
    for k, (name, ink) in enumerate(INKS.items()):
        share = 100 * score.held_out[name] / torque
        axes.bar(x + 0.27 * (k - 1), share, 0.25, color=ink, label=name)
    floor = 100 * np.array(score.diagnosis.noise_floor) / torque
    axes.hlines(
        floor, x - 0.42, x + 0.42, color=RED, linewidth=1.4, label="noise floor"
    )
    axes.set_ylabel("RMS gap [% of RMS torque]")
    axes.set_xticks(x, score.diagnosis.joints)
    axes.tick_params(axis="x", labelsize=7)
    legend(figure, axes.get_legend_handles_labels()[0])
    return figure


def _cells(f: Finding, d: Diagnosis) -> tuple[str, ...]:
    numbers = [str(d.joints.index(j) + 1) for j in f.joints]
    motion = f.shrink.get("motion")
    torque = f.shrink["torque"]
    return (
        f.effect,
        ", ".join(f.alternatives[1:]) or "–",
        ", ".join(numbers),
        f"{f.share:.1%}",
        _shrunk(torque.before, torque.after, torque.removed, torque.interval, "N·m"),
        "not replayed" if motion is None else _shrunk(
            motion.before, motion.after, motion.removed, motion.interval,
            f"rad over {motion.horizon_s:g} s",
        ),
    )  # fmt: skip


def _shrunk(
    before: float, after: float, removed: float, ends: tuple[float, float], unit: str
) -> str:
    low, high = ends
    return f"{removed:.0%} ({low:.0%} to {high:.0%}): {before:.3g} → {after:.3g} {unit}"


def _place(r: Region) -> str:
    return (
        f"{r.joint}, {r.variable} {r.low:.3g} to {r.high:.3g} {r.unit}: {r.share:.0%} "
        f"({r.interval[0]:.0%} to {r.interval[1]:.0%})"
    )
