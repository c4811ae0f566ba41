"""Cases of ``tune_thresholds.py``, answered with many limits; no printing."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from blind.case import Case
from blind.run import make, read_open, read_rows

from hybrid.diagnose.attribute import Search
from hybrid.diagnose.explanation import split
from hybrid.diagnose.measure import measure_gap
from hybrid.diagnose.thresholds import thresholds
from hybrid.diagnose.vetted import vetted

LOG = Path(__file__).parents[1] / "build" / "tune_thresholds.jsonl"
# As they are, and one after the other changed.
TRIALS: tuple[tuple[str, float], ...] = (
    ("version", 0.0),
    *(
        (name, value)
        for name, values in {
            "alike": (1.0, 10.0),
            "alike_share": (0.02, 0.1),
            "spurious": (0.01, 0.1),
            "coloured": (0.2, 0.5),
            "evident": (12.0, 48.0),
            "negligible": (0.002, 0.01),
            "complete": (0.85, 0.9, 0.96),
            "roughly": (0.7, 0.9),
            "steady": (0.1, 0.5),
            "crowded": (5, 40),
            "undone": (0.2, 0.4),
        }.items()
        for value in values
    ),
)


def checked_cases(
    cases: Sequence[Case], workers: int, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Rows of all cases that can be made; those in the log are not run again."""
    known = read_rows(LOG)
    LOG.parent.mkdir(exist_ok=True)
    wanted = [case for case in cases if case.key not in known]
    with ProcessPoolExecutor(workers) as pool:
        for row in pool.map(checked, wanted):
            known[row["key"]] = row
            with LOG.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            tell(row["key"])
    return [known[case.key] for case in cases if known[case.key]["truth"]]


def checked(case: Case) -> dict[str, Any]:
    """What is named of a case under each of the limits, with what is alike to it."""
    with TemporaryDirectory() as folder:
        visible, sealed = Path(folder) / "open", Path(folder) / "sealed"
        if make(case, Path(folder), visible, sealed):
            return {"key": case.key, "truth": None}
        robot, recordings, without = read_open(visible)
        truth = json.loads((sealed / "truth.json").read_text(encoding="utf-8"))
    gap = measure_gap(robot, recordings)
    search = Search(gap, split(gap), without=without)
    terms, named = search.run(), []
    for name, value in TRIALS:
        limits = thresholds()
        search.terms = list(terms)
        if name != "version":
            limits = replace(limits, **{name: value})
        _, kinds, _ = vetted(gap, search, limits)
        kept = sorted(search.terms, key=search.loss, reverse=True)
        named.append([_named(t, robot.joints, kinds[t]) for t in kept])
    return {"key": case.key, "truth": truth, "named": named}


def _named(term: Any, joints: Sequence[str], kinds: Sequence[str]) -> list[Any]:
    effect, at = term.place
    at = at[-1:] if effect == "link_inertia" else at
    return [effect, [joints[j] for j in at], list(kinds)]
