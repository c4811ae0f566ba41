"""The report of a diagnosis: a page that opens anywhere, and its JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from hybrid.diagnosis.gap.units import units
from hybrid.effects import effect_classes
from hybrid.files import atomic_path
from hybrid.report.diagnosis_curves import joint_curves, rms_table
from hybrid.report.diagnosis_evidence import evidence_matrix
from hybrid.report.diagnosis_text import (
    effect_name,
    effects_listed,
    number,
    pushes,
    range_name,
    region_name,
    shrink_sentence,
    value_cells,
    verdict_sentence,
    words,
)
from hybrid.report.output import provenance, write_results
from hybrid.report.page import render_template

if TYPE_CHECKING:
    from hybrid.diagnosis.answer.diagnosis import Advice, Diagnosis, Finding, Shrink
    from hybrid.diagnosis.answer.result import Result

PAGE, CONTENT = "report.html", "diagnosis.json"

_SMALL = 0.005  # a share that would be shown as 0%

# Told apart by colour-blind readers, and by lightness in print.
_INKS = ("#08519c", "#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#5a5a5a")


def write_diagnosis(result: Result, directory: str | Path) -> None:
    """Write ``report.html`` and ``diagnosis.json``.

    Args:
        result: A diagnosis with what it was made from. Its provenance, if it has none,
            becomes the versions of all packages.
        directory: Folder; made if it is missing.
    """
    directory, diagnosis = Path(directory), result.diagnosis
    if not diagnosis.provenance:
        diagnosis = replace(diagnosis, provenance=provenance())
    page = render_diagnosis(replace(result, diagnosis=diagnosis))
    with atomic_path(directory / PAGE) as temporary:
        temporary.write_text(page, encoding="utf-8")
    write_results(directory / CONTENT, diagnosis.as_dict())


def render_diagnosis(result: Result) -> str:
    """The page that :func:`write_diagnosis` writes."""
    diagnosis = result.diagnosis
    curves = [joint_curves(result, i) for i in range(len(diagnosis.joints))]
    return render_template(
        "diagnosis.html",
        title=f"{diagnosis.robot}: simulator against robot",
        lead=verdict_sentence(diagnosis),
        diagnosis=diagnosis,
        rows=_overview(result),
        shares=_shares(diagnosis),
        findings=[_finding(f, _ink(k)) for k, f in enumerate(diagnosis.findings)],
        remainder=_remainder(result),
        matrix=evidence_matrix(result),
        late=bool(result.late),
        regions=_regions(diagnosis),
        variables=list(dict.fromkeys(r.variable for r in diagnosis.where)),
        advice=[_advice(x) for x in diagnosis.advice],
        pushes=list(pushes(diagnosis)),
        effect_name=effect_name,
        number=number,
        data=_embedded(
            {"joints": curves, "inks": _inks(diagnosis), "first": _widest(result)}
        ),
        provenance=_readable(diagnosis.provenance),
    )


def _overview(result: Result) -> list[dict[str, Any]]:
    """Each joint's gap, as a part of the largest relative gap."""
    table = rms_table(result)
    shares = [max(x["today"], x["after"]) / x["torque"] for x in table if x["torque"]]
    widest = max(shares, default=1.0)
    return [
        {
            "joint": joint,
            "unit": units(result.gap.robot, [i])[1],
            "rms": {k: number(row[k]) for k in row},
            "percent": number(100 * row["today"] / row["torque"])
            if row["torque"]
            else "",
            # Bars are relative to the torque: a wrist is as visible as a shoulder.
            "width": {
                k: 100 * min(1.0, row[k] / row["torque"] / widest)
                if row["torque"]
                else 0
                for k in ("today", "after", "noise")
            },
        }
        for i, (joint, row) in enumerate(
            zip(result.diagnosis.joints, table, strict=True)
        )
    ]


def _shares(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Parts of the explainable gap, in per cent: each finding's, and the rest."""
    explained = 1.0 - diagnosis.unexplained
    parts: list[dict[str, Any]] = [
        {"name": effect_name(f.effect), "ink": _ink(k), "part": f.share * explained}
        for k, f in enumerate(diagnosis.findings)
    ]
    if diagnosis.unexplained >= _SMALL:
        parts.append({"name": "unexplained", "ink": "", "part": diagnosis.unexplained})
    return [{**x, "part": 100 * x["part"]} for x in parts]


def _remainder(result: Result) -> list[dict[str, str]]:
    """Joints where structure is left, and what a flexible regression says of it."""
    found = result.account
    whole = float((found.explained + found.missed).sum())
    if not (whole > 0 and result.diagnosis.unexplained >= _SMALL):
        return []
    parts = zip(
        result.diagnosis.joints, found.missed / whole, found.depends, strict=True
    )
    rows = sorted(parts, key=lambda x: -x[1])
    return [
        {"joint": joint, "share": f"{part:.0%}", "depends": depends}
        for joint, part, depends in rows
        if part >= _SMALL
    ]


def _finding(f: Finding, ink: str) -> dict[str, Any]:
    cls = effect_classes().get(f.effect)
    return {
        "name": effect_name(f.effect),
        "ink": ink,
        "joints": words(f.joints),
        "share": f"{f.share:.0%}",
        "sentence": f.sentence,
        "alike": effects_listed(f.alternatives[1:], "or"),
        "shrink": [_shrink(kind, s) for kind, s in f.shrink.items()],
        "parameters": [(v.joint, v.name, *value_cells(v)) for v in f.parameters],
        "remedy": f.remedy,
        "equation": cls.equation if cls else "",
        "source": cls.source if cls else "",
    }


def _shrink(kind: str, s: Shrink) -> dict[str, Any]:
    """A sentence, and how much is left, in per cent, with its interval."""
    low, high = (100 * min(1.0, max(0.0, 1.0 - x)) for x in reversed(s.interval))
    left = 100 * min(1.0, s.after / s.before) if s.before > 0 else 0.0
    return {"text": shrink_sentence(kind, s), "left": left, "low": low, "high": high}


def _regions(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    widest = max((r.interval[1] for r in diagnosis.where), default=0.0) or 1.0
    return [
        {
            "name": region_name(r),
            "joint": r.joint,
            "variable": r.variable,
            "range": range_name(r),
            "share": f"{r.share:.0%}",
            "interval": f"{r.interval[0]:.0%} to {r.interval[1]:.0%}",
            "shade": round(100 * max(0.0, min(1.0, r.share))),
            "width": 100 * max(0.0, r.share) / widest,
            "low": 100 * max(0.0, r.interval[0]) / widest,
            "high": 100 * r.interval[1] / widest,
        }
        for r in diagnosis.where
    ]


def _advice(x: Advice) -> dict[str, str]:
    return {
        "experiment": x.experiment,
        "splits": effects_listed(x.splits, "from"),
        "separation": number(x.separation, 2),
        "file": x.file,
    }


def _widest(result: Result) -> int:
    """The joint with most of the gap above noise: the one to look at first."""
    above = result.account.explained + result.account.missed
    return int(above.argmax())


def _ink(k: int) -> str:
    return _INKS[k % len(_INKS)]


def _inks(diagnosis: Diagnosis) -> dict[str, str]:
    return {f.effect: _ink(k) for k, f in enumerate(diagnosis.findings)}


def _embedded(content: Mapping[str, Any]) -> Markup:
    """JSON inside a script element; no name in it can end the element."""
    text = json.dumps(
        content, allow_nan=False, ensure_ascii=False, separators=(",", ":")
    )
    return Markup(text.replace("<", "\\u003c"))


def _readable(made: Mapping[str, Any]) -> dict[str, Any]:
    """Provenance for the foot of a page: a file and its hash are one entry."""

    def entry(x: Any) -> Any:
        if isinstance(x, Mapping):
            return " ".join(map(str, x.values()))
        return x

    def plain(x: Any) -> Any:
        several = isinstance(x, Sequence) and not isinstance(x, str)
        return [entry(item) for item in x] if several else x

    return {name: plain(x) for name, x in made.items()}
