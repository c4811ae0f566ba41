"""Write the report of a diagnosis: a self-contained page, and JSON."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from hybrid.arrays import Array
from hybrid.diagnosis.answer import words
from hybrid.diagnosis.answer.diagnosis import Diagnosis
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.words import effect_name
from hybrid.effects import effect_classes
from hybrid.files import atomic_path
from hybrid.report.diagnosis_data import evidence_matrix, joint_curves
from hybrid.report.excitation import Postures
from hybrid.report.output import provenance, render_page, write_results

PAGE, CONTENT = "report.html", "diagnosis.json"

_SMALL = 0.005  # a smaller share is shown as 0 %

_HATCHED = "repeating-linear-gradient(45deg,var(--grey) 0 3px,var(--faint) 3px 7px)"
_BLUE, _GOLDEN = 255.0, 137.5  # hue of the first colour, golden angle, [°]
_LIGHTNESS = (0.52, 0.66)  # in turn, so that colours differ without their hue as well


def write_diagnosis(result: Result, directory: str | Path, *, fixed: str = "") -> None:
    """Write ``report.html`` and ``diagnosis.json`` into a folder.

    Without a provenance the diagnosis gets the versions of all packages. The page
    links the ``fixed`` simulator, a file beside it.
    """
    directory, diagnosis = Path(directory), result.diagnosis
    if not diagnosis.provenance:
        diagnosis = replace(diagnosis, provenance=provenance())
    page = render_diagnosis(replace(result, diagnosis=diagnosis), fixed)
    with atomic_path(directory / PAGE) as temporary:
        temporary.write_text(page, encoding="utf-8")
    write_results(directory / CONTENT, diagnosis.as_dict())


def render_diagnosis(result: Result, fixed: str = "") -> str:
    """The page that :func:`write_diagnosis` writes."""
    diagnosis, matrix = result.diagnosis, evidence_matrix(result)
    curves = [joint_curves(result, i) for i in range(len(diagnosis.joints))]
    rows, longest = _gap_rows(result)
    inks, known = _colours(len(diagnosis.findings)), effect_classes()
    drawn = {
        "joints": curves,
        "inks": {
            f.effect: ink for f, ink in zip(diagnosis.findings, inks, strict=True)
        },
        "first": int((result.account.explained + result.account.missed).argmax()),
        "after": "repaired" if result.effects else "its own numbers corrected",
        "arm": _arm(result),
        "gaps": [row["above"] for row in rows],
    }
    return render_page(
        "diagnosis.html",
        title=f"{diagnosis.robot}: simulator against robot",
        lead=words.verdict_sentence(diagnosis),
        said=words,
        diagnosis=diagnosis,
        fixed=fixed,
        rows=rows,
        longest=longest,
        shares=_shares(diagnosis, inks),
        inks=inks,
        laws={f.effect: known.get(f.effect) for f in diagnosis.findings},
        remainder=_remainder(result),
        matrix=matrix,
        delays=bool(result.delays),
        data=_json_markup(drawn),
        provenance=diagnosis.provenance,
    )


def _gap_rows(result: Result) -> tuple[list[dict[str, Any]], float]:
    """RMS gap of each joint on held-out samples, with the widths of its bars.

    Bars are relative to each joint's torque, so that small joints are visible. The
    second result is the largest relative gap.
    """
    gap, scored, found = result.gap, result.scored, result.diagnosis
    after = found.unseen.after if found.unseen else [_rms(x) for x in scored.after]
    rows: list[dict[str, Any]] = [
        {
            "today": _rms(gap.left[seen, i]),
            "after": float(np.nan_to_num(after[i])),  # NaN where it does not move
            "noise": found.noise_floor[i],
            "torque": _rms(gap.measured[seen, i]),
        }
        for i, seen in enumerate(scored.evidence.rows)
    ]
    shares = [max(x["today"], x["after"]) / x["torque"] for x in rows if x["torque"]]
    longest = max(shares, default=1.0) or 1.0
    for i, row in enumerate(rows):
        whole = longest * row["torque"] or np.inf
        width = {k: 100 * min(1.0, x / whole) for k, x in row.items()}
        above = max(0.0, width["today"] ** 2 - width["noise"] ** 2)
        row |= {"width": width, "above": np.sqrt(above) / 100}
        row |= {"joint": found.joints[i], "unit": gap.robot.chain.unit_at([i], "N·m")}
    return rows, longest


def _rms(x: Array) -> float:
    """Root of the mean square; 0 at a joint that does not move."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else 0.0


def _arm(result: Result) -> dict[str, Any]:
    """Joints and capsules of the arm at the first sample, [m]."""
    found = Postures.of(result.gap.robot, result.gap.sampled.q[:1])
    parts = {"joints": found.joints[0], "ends": found.ends[0], "radius": found.radius}
    return {name: x.round(4).tolist() for name, x in parts.items()}


def _shares(diagnosis: Diagnosis, inks: Sequence[str]) -> list[tuple[str, str, float]]:
    """Name, colour and share of the gap above noise, of each finding and the rest."""
    rest = diagnosis.unexplained if diagnosis.unexplained >= _SMALL else 0.0
    found = zip(diagnosis.findings, inks, strict=True)
    parts = [(effect_name(f.effect), ink, f.share * (1 - rest)) for f, ink in found]
    return [*parts, ("unexplained", _HATCHED, rest)] if rest else parts


def _remainder(result: Result) -> list[tuple[str, float, str]]:
    """Joints with an unexplained gap, their shares, and the variable it depends on."""
    found, joints = result.account, result.diagnosis.joints
    whole = float((found.explained + found.missed).sum())
    if not (whole > 0 and result.diagnosis.unexplained >= _SMALL):
        return []
    parts = zip(joints, found.missed / whole, found.depends, strict=True)
    return sorted((x for x in parts if x[1] >= _SMALL), key=lambda x: -x[1])


def _colours(count: int) -> list[str]:
    """Distinct colours, with hues at steps of the golden angle."""
    return [
        f"oklch({_LIGHTNESS[k % 2]} 0.14 {(_BLUE + _GOLDEN * k) % 360:.0f})"
        for k in range(count)
    ]


def _json_markup(content: Mapping[str, Any]) -> Markup:
    """JSON for a script element, escaped so that no name can end the element."""
    text = json.dumps(
        content, allow_nan=False, ensure_ascii=False, separators=(",", ":")
    )
    return Markup(text.replace("<", "\\u003c"))
