"""Limits of the diagnosis: is one other than it is worth more, also for other effects?

Each case is answered with the limits in ``hybrid/diagnose/thresholds.json`` and with
every one of them changed, up and down. Two scores appear: of the limits that are best
on all cases, and the nested one, for which the cases of every effect are answered with
what is best on the cases of all others; it is what may be hoped for of an effect that
nobody has thought of. All cases are of the arm tuned on. ``--write`` puts the best
limits into the file; run it again until none is better.

    python experiments/tune_thresholds.py --cases 60 --workers 2
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from blind.case import TUNED, plan
from blind.score import Named, score
from outputs import command_line
from rich.console import Console
from tune_thresholds_cases import TRIALS, checked_cases

from hybrid.diagnose.thresholds import thresholds
from hybrid.files import atomic_path, write_json
from hybrid.report import Table, markdown_table, provenance, write_results

ROOT = Path(__file__).parents[1]
FILE = ROOT / "hybrid" / "diagnose" / "thresholds.json"
STRATA = ("single", "withheld", "none", "pair", "unknown")
WRONG = 2.0  # a false cause costs this, a right answer gives one
NAMES = ("as it is", *(f"{name} {value:g}" for name, value in TRIALS[1:]))


def worth(truth: Mapping[str, Any], named: Sequence[Sequence[Any]]) -> float:
    """Of the answer to a case: 1 if right, less if something false is named."""
    got = score(truth, [Named(e, tuple(j), tuple(kinds)) for e, j, kinds in named])
    known = truth["case"]["stratum"] in ("single", "pair")
    if not (got["declared"] and (not got["false"] or not known)):
        return -WRONG
    return got["found"] / len(truth["effects"]) if known else 1.0


def best(worths: np.ndarray) -> int:
    """The limits worth most, of some cases (C, L); as they are unless others are."""
    return int(np.argmax(worths.sum(axis=0)))


def main() -> None:
    """Answer all cases, choose, score nested, and write if asked to."""
    parser = command_line(__doc__, "thresholds")
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    args, console = parser.parse_args(), Console(width=120)
    robots = [f"models/{name}.xml" for name in TUNED]
    cases = plan(robots, args.cases, seed=args.seed, strata=STRATA)
    rows = checked_cases(cases, args.workers, console.print)
    worths = np.array([[worth(r["truth"], x) for x in r["named"]] for r in rows])
    group = [{e["effect"] for e in r["truth"]["effects"]} for r in rows]
    nested, chosen = [], Counter[str]()
    for effect in sorted(set().union(*group)):
        own = np.array([effect in g for g in group])
        choice = best(worths[~own])
        chosen[NAMES[choice]] += 1
        nested += worths[own, choice].tolist()
    picked = best(worths)
    lines = tuple(
        (name, f"{x:.3f}", str(chosen[name] or ""))
        for name, x in zip(NAMES, worths.mean(axis=0), strict=True)
    )
    heading = f"Worth of an answer to {len(rows)} cases, by limits"
    table = Table(("", "worth", "best without one effect"), lines, heading)
    said = (
        f"Best on all: {NAMES[picked]}, {worths[:, picked].mean():.3f}. Nested: "
        f"{np.mean(nested):.3f} over {len(nested)} cases, as it is "
        f"{np.mean([worths[i, 0] for i, g in enumerate(group) for _ in g]):.3f}."
    )
    console.print(said, highlight=False)
    command = (
        f"python experiments/tune_thresholds.py --cases {args.cases} --seed {args.seed}"
    )
    content = {"provenance": provenance(command=command), "names": NAMES}
    write_results(args.out / "results.json", content | {"worths": worths})
    with atomic_path(args.out / "table.md") as path:
        path.write_text(
            f"{heading}.\n\n{markdown_table(table)}\n{said}\n\n    {command}\n"
        )
    if args.write and picked:
        name, value = TRIALS[picked]
        write_json(FILE, vars(thresholds()) | {name: value})


if __name__ == "__main__":
    main()
