"""What all answers of one version of the code come to, over many plants.

The runs of ``own_loops``, bare and not, ``own_loops_pairs``, ``own_loops_withheld``,
``own_loops_motions`` and ``healthy_arms`` are read from their reports. A table has a
share with its Wilson interval for each question, and a figure how often the first cause
is wrong among the most certain answers (risk over coverage). "As large" is an effect
that adds as much to the gap of a joint as is there without it: noise, and small errors
of the file, of which any missing friction is none.

    python experiments/pooled_evidence.py FOLDER FOLDER
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from blind.measures import Ratio
from blind.score import EQUIVALENT
from outputs import command_line
from rich.console import Console
from sklearn.metrics import roc_auc_score

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, save_figure, terminal_table
from hybrid.report.style import BLUE, clean, new_figure


@dataclass(frozen=True)
class Answer:
    """One diagnosis, and what is true of its plant.

    Attributes:
        true: Effects with their joints; none of a healthy arm.
        named: Findings.
        verdict: Verdict.
        withheld: Whether the effect was left out of the library.
        size: What an only effect adds to the gap, at most at a joint, in units of the
            gap that is there without it: noise, and small errors of the file.
    """

    true: tuple[tuple[str, str], ...]
    named: tuple[dict[str, Any], ...]
    verdict: str
    withheld: bool
    size: float
    intervals: tuple[tuple[float, float, float], ...] = ()

    @property
    def first(self) -> bool:
        """Whether the class that is named first holds the cause, at its joint."""
        ((kind, joint),), named = self.true, self.named[:1]
        return any(kind in x["class"] and joint in x["joints"] for x in named)

    @property
    def certain(self) -> float:
        """Probability of the first finding; 0 without one, 1 where it has none."""
        if not self.named:
            return 0.0
        found = self.named[0]["probability"]
        return 1.0 if found is None else float(found)  # of a command: none is computed


def answers(run: Any, usual: bool) -> Iterator[Answer]:
    """All answers of an entry of a report.

    Args:
        run: The entry.
        usual: Whether the file lacks friction, which is named as well.
    """
    if isinstance(run, list):
        for x in run:
            yield from answers(x, usual)
    elif "added" in run:
        yield _answer(run["withheld"], True, usual)
        yield _answer(run["added"], False, usual)
    elif "file" in run:
        for against in ("file", "model"):
            yield _answer(run[against] | {"true": []}, False, usual)
    else:
        yield _answer(run, False, usual)


def _answer(run: dict[str, Any], withheld: bool, usual: bool) -> Answer:
    true = tuple((kind, joint) for kind, joint in run["true"] if kind != "none")
    own = {kind for kind, _ in true}
    left_out = {"coulomb", "viscous", "armature"} - own if usual else set()
    named = tuple(x for x in run["named"] if x["effect"] not in left_out)
    size = run["sizes"][0] if len(true) == 1 else np.nan
    known_values = tuple((x[-3], x[-2], x[-1]) for x in run.get("intervals", ()))
    return Answer(true, named, run["verdict"], withheld, size, known_values)


def measures(found: Sequence[Answer]) -> list[tuple[str, Ratio]]:
    """The share of each question."""
    one = [x for x in found if len(x.true) == 1 and not x.withheld]
    large = [x for x in one if x.size >= 1.0]
    kept = [x for x in found if x.withheld]
    two, sound = ([x for x in found if len(x.true) == k] for k in (2, 0))
    both = [all(_names(x, e) for e in x.true) for x in two]
    told = [x for x in kept if x.verdict != "no_gap" or x.size >= 1.0]
    alike = [not x.named or _equivalent(x) for x in told]
    missed = [x.verdict == "no_gap" for x in told]
    strict = [not x.named and not m for x, m in zip(told, missed, strict=True)]
    values = [x for a in found for x in a.intervals]
    return [
        ("cause first, in class", _ratio(x.first for x in one)),
        ("the same, as large", _ratio(x.first for x in large)),
        ("as large: a false one besides", _ratio(len(x.named) > 1 for x in large)),
        ("as large, and nothing is named", _ratio(not x.named for x in large)),
        ("as large: the effect itself first",
         _ratio(x.first and x.named[0]["effect"] == x.true[0][0] for x in large)),
        ("as large: first at its joint", _ratio(map(_at_joint, large))),
        ("0.15 to 0.6 of the noise: cause first, in class",
         _ratio(x.first for x in one if 0.15 <= x.size < 0.6)),
        ("class holds the cause, where something is named at its joint",
         _ratio(x.first for x in one if _at_joint(x))),
        ("95 % interval of a parameter holds its value",
         _ratio(low <= true <= high for true, low, high in values)),
        ("two at once: both", _ratio(both)),
        ("healthy: something is named", _ratio(bool(x.named) for x in sound)),
        ("withheld, a gap is told or as large: abstains or equivalent",
         _ratio(a and not m for a, m in zip(alike, missed, strict=True))),
        ("the same, strictly", _ratio(strict)),
    ]  # fmt: skip


def _names(x: Answer, effect: tuple[str, str]) -> bool:
    kind, joint = effect
    return any(kind in f["class"] and joint in f["joints"] for f in x.named)


def _at_joint(x: Answer) -> bool:
    return bool(x.named) and x.true[0][1] in x.named[0]["joints"]


def _equivalent(x: Answer) -> bool:
    return x.named[0]["effect"] in EQUIVALENT.get(x.true[0][0], ())


def _ratio(held: Any) -> Ratio:
    each = list(held)
    return Ratio(sum(map(bool, each)), len(each))


def risk(found: Sequence[Answer]) -> tuple[list[float], list[float]]:
    """Coverage, and the share of wrong first causes among the most certain answers.

    Of answers about one effect of any size, known or withheld, at most all that name a
    cause are covered.
    """
    told = [x for x in found if len(x.true) == 1]
    named = sorted((x for x in told if x.named), key=lambda x: -x.certain)
    wrong = np.cumsum([not _right(x) for x in named])
    count = np.arange(1, len(named) + 1)
    return (count / len(told)).tolist(), (wrong / count).tolist()


def _right(x: Answer) -> bool:
    return _equivalent(x) if x.withheld else x.first


def known_from_unknown(found: Sequence[Answer]) -> float:
    """AUROC of the first finding's probability: is the cause in the library?"""
    told = [x for x in found if len(x.true) == 1 and x.size >= 1.0]
    told = [x for x in told if not (x.withheld and x.named and _equivalent(x))]
    truth = [not x.withheld for x in told]
    return float(roc_auc_score(truth, [x.certain for x in told]))


def main() -> None:
    """Read the reports, print the table, write it with the figure."""
    parser = command_line(__doc__, "pooled_evidence")
    parser.add_argument("folders", type=Path, nargs="+")
    args, found, plants = parser.parse_args(), list[Answer](), 0
    for folder in args.folders:
        content = json.loads((folder / "results.json").read_text("utf-8"))
        usual = "--bare" in content["provenance"]["command"]
        for run in content["runs"]:
            found += answers(run, usual)
            plants += len(run) if isinstance(run, list) else 1
    coverage, wrong = risk(found)
    area = float(np.trapezoid([wrong[0], *wrong], [0.0, *coverage]) / coverage[-1])
    rows = []
    for name, x in measures(found):
        if not x.total:
            continue
        low, high = x.interval
        rows.append(
            (
                name,
                f"{x.hits} of {x.total}",
                f"{x.value:.1%}",
                f"{low:.0%} to {high:.0%}",
            )
        )
    off = [
        3.92 * (true - (low + high) / 2) / (high - low)
        for a in found for true, low, high in a.intervals if high > low
    ]  # fmt: skip
    usual = f"{np.median(np.abs(off)):.2f}" if off else "–"
    rows.append(("median error of a parameter, standard deviations", usual, "", ""))
    classes = [len(x.named[0]["class"]) for x in found if x.named]
    rows.append(("mean size of the first class", f"{np.mean(classes):.2f}", "", ""))
    if any(x.withheld for x in found):
        auroc = f"{known_from_unknown(found):.3f}"
        rows.append(("AUROC of known against withheld causes, as large", auroc, "", ""))
    rows.append(("area under risk over coverage (AURC)", f"{area:.3f}", "", ""))
    table = Table(
        ("", "count", "share", "95 % interval"), tuple(rows),
        f"{len(found)} diagnoses of {plants} plants, by one version", words=True,
    )  # fmt: skip
    Console(width=160).print(terminal_table(table))
    command = "python experiments/pooled_evidence.py " + " ".join(
        map(str, args.folders)
    )
    with atomic_path(args.out / "table.md") as path:
        path.write_text(f"{table.caption}.\n\n{markdown_table(table)}\n    {command}\n")
    figure = new_figure(3.0)
    axes = figure.subplots()
    axes.plot(coverage, wrong, color=BLUE)
    axes.set(xlabel="coverage: share of faults with an answer", ylim=(0.0, None))
    axes.set_ylabel("wrong first causes among them")
    clean(axes, "y")
    save_figure(figure, args.out / "risk.svg")


if __name__ == "__main__":
    main()
