"""Cases of ``tune_thresholds.py``, with what speaks against each term; no printing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hybrid.benchmark.case import Case
from hybrid.benchmark.run import make, read_open, read_rows
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.explanation import split
from hybrid.diagnose.gap import measure_gap
from hybrid.diagnose.thresholds import thresholds
from hybrid.diagnose.verify import account, check

LOG = Path(__file__).parents[1] / "build" / "tune_thresholds.jsonl"
SPURIOUS = (0.02, 0.05, 0.1)


def checked_cases(
    cases: tuple[Case, ...], tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Rows of all cases that can be made; those in the log are not run again."""
    known = read_rows(LOG)
    LOG.parent.mkdir(exist_ok=True)
    for case in cases:
        if case.key not in known:
            known[case.key] = checked(case)
            with LOG.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[case.key]) + "\n")
            tell(case.key)
    return [known[case.key] for case in cases if known[case.key]["truth"]]


def checked(case: Case) -> dict[str, Any]:
    """What speaks against each term of a case, under each limit of the account."""
    with TemporaryDirectory() as folder:
        visible, sealed = Path(folder) / "open", Path(folder) / "sealed"
        if make(case, Path(folder), visible, sealed):
            return {"key": case.key, "truth": None}
        robot, recordings, without = read_open(visible)
        truth = json.loads((sealed / "truth.json").read_text(encoding="utf-8"))
    gap = measure_gap(robot, recordings)
    search = Search(gap, split(gap), without=without)
    terms, rows = sorted(search.run(), key=search.loss, reverse=True), {}
    for level in SPURIOUS:
        found = account(gap, search, replace(thresholds(), spurious=level))
        rows[str(level)] = [asdict(check(search, t, found)) for t in terms]
    named = [(t.place[0], [robot.joints[j] for j in t.place[1]]) for t in terms]
    return {"key": case.key, "truth": truth, "named": named, "checks": rows}
