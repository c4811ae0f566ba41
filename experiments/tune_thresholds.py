"""Limits of the diagnosis, chosen so that each effect is judged by all the others.

Two scores appear: with limits chosen on all cases, and the nested one, for which the
cases of every effect are answered with limits chosen without them; it is what may be
hoped for of an effect that nobody has thought of. All cases are of the arm tuned on.
``--write`` puts the limits into ``hybrid/diagnose/thresholds.json``.

    python experiments/tune_thresholds.py --cases 300 --write
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from tune_thresholds_cases import SPURIOUS, checked_cases

from hybrid.benchmark.case import TUNED, plan
from hybrid.benchmark.score import Named, score
from hybrid.diagnose.thresholds import Thresholds, thresholds
from hybrid.diagnose.verify import Check
from hybrid.files import write_json

FILE = Path(__file__).parents[1] / "hybrid" / "diagnose" / "thresholds.json"
GRID = {
    "complete": (0.5, 0.6, 0.7, 0.8, 0.9, 0.95),
    "steady": (0.05, 0.1, 0.25, 0.5, 1.0),
    "crowded": (3, 5, 9, 40),
    "undone": (0.0, 0.1, 0.2, 0.3, 0.4),
}
STRATA = ("single", "withheld", "none", "pair", "unknown")
WRONG = 2.0  # a false cause costs this, a right answer gives one


def worth(row: Mapping[str, Any], limits: Thresholds) -> float:
    """Of the answer to a case: 1 if right, less if something false is named."""
    checks = row["checks"][str(limits.spurious)]
    parts = zip(row["named"], checks, strict=True)
    kept = [x for x, c in parts if Check(**c).passes(limits)]
    kept = [(e, j[-1:] if e == "link_inertia" else j) for e, j in kept]
    got = score(row["truth"], [Named(e, tuple(j), (e,)) for e, j in kept])
    known = row["truth"]["case"]["stratum"] in ("single", "pair")
    if not (got["declared"] and (not got["false"] or not known)):
        return -WRONG
    return got["found"] / len(row["truth"]["effects"]) if known else 1.0


def best(rows: Sequence[Mapping[str, Any]]) -> Thresholds:
    """The limits worth most on some cases; of equal ones the middle, far from edges."""
    trials = [
        replace(thresholds(), spurious=s, **dict(zip(GRID, values, strict=True)))
        for s, *values in product(SPURIOUS, *GRID.values())
    ]
    worths = [sum(worth(row, limits) for row in rows) for limits in trials]
    first = np.flatnonzero(np.array(worths) == max(worths))
    return trials[first[len(first) // 2]]


def main() -> None:
    """Check all cases, choose, score nested, and write if asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true")
    args, console = parser.parse_args(), Console(width=200)
    robots = [f"models/{name}.xml" for name in TUNED]
    cases = plan(robots, args.cases, seed=args.seed, strata=STRATA)
    rows = checked_cases(cases, console.print)
    group = [{e["effect"] for e in row["truth"]["effects"]} for row in rows]
    nested = []
    for effect in sorted(set().union(*group)):
        limits = best([r for r, g in zip(rows, group, strict=True) if effect not in g])
        nested += [
            worth(r, limits) for r, g in zip(rows, group, strict=True) if effect in g
        ]
    limits = best(rows)
    console.print(f"all cases {np.mean([worth(r, limits) for r in rows]):.3f}")
    console.print(f"nested {np.mean(nested):.3f} over {len(nested)} cases", limits)
    if args.write:
        write_json(FILE, asdict(limits))


if __name__ == "__main__":
    main()
