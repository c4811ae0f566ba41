"""Whether the tests can fail: one change at a time to the code, and who notices.

Cosmic Ray makes the changes (an operator, a number, a condition, a loop). A seed draws
some of all that are possible. Each meets, in a process of its own, the cheapest of
the tests that execute its line. A change that none of them notices has survived.

    python benchmarks/mutants.py --out reports/mutants
    python benchmarks/mutants.py --out here --seed 7 --count 50 --only hybrid/signals

A campaign that was stopped, or ended after `--minutes`, goes on where it was: what was
killed stays so while its module is the same, what survived is tried anew when its tests
have changed. A survivor that no test could notice is named, with the reason, in
`equivalent.toml` beside the results; it is counted apart.
"""

from __future__ import annotations

import argparse
import difflib
import json
import time
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mutation import ROOT, Mutant, digest, drawn
from sandbox import Sandbox

from hybrid.report import Table, markdown_table, provenance, write_results

COMMAND = "python benchmarks/mutants.py --out reports/mutants"
WORK = ROOT / "build" / "mutants"
DETECTED = ("killed", "timeout")
Row = dict[str, Any]


def diff(mutant: Mutant) -> str:
    """The change as a patch without context."""
    before = (ROOT / mutant.path).read_text().splitlines()
    lines = difflib.unified_diff(before, mutant.source().splitlines(), n=0, lineterm="")
    return "\n".join(list(lines)[2:])


def read_rows(path: Path) -> dict[str, Row]:
    """What earlier runs found, by the mutant's key."""
    if not path.exists():
        return {}
    rows = map(json.loads, path.read_text().splitlines())
    return {row["key"]: row for row in rows if row["outcome"] != "broken"}


def campaign(mutants: Sequence[Mutant], minutes: float) -> list[Row]:
    """Outcomes that the log has, and those of as many others as time allows."""
    WORK.mkdir(parents=True, exist_ok=True)
    log = WORK / "mutants.jsonl"
    done, found = read_rows(log), {}
    end = time.monotonic() + 60 * minutes
    with Sandbox() as sandbox, log.open("a") as out:
        witnesses = sandbox.witnesses(WORK / "witnesses.json")
        tests = {m: witnesses.digest(m) for m in mutants}
        for mutant in mutants:
            row = done.get(mutant.key)
            if row and _valid(row, mutant, tests[mutant]):
                found[mutant.key] = row
        left = [m for m in mutants if m.key not in found]
        for mutant, (outcome, seconds, failed) in sandbox.outcomes(left, witnesses):
            row = found[mutant.key] = {
                "key": mutant.key,
                "path": mutant.path,
                "outcome": outcome,
                "seconds": round(seconds, 2),
                "failed": failed,
                "diff": diff(mutant),
                "source": digest(mutant.source()),
                "tests": tests[mutant],
            }
            print(f"{outcome:9} {seconds:6.1f} s  {mutant.path}  {failed}", flush=True)
            print(json.dumps(row), file=out, flush=True)
            if time.monotonic() > end:
                break
    return list(found.values())


def _valid(row: Row, mutant: Mutant, tests: str) -> bool:
    """Whether an outcome needs no other try."""
    same = row["source"] == digest(mutant.source())
    return same and (row["outcome"] in DETECTED or row["tests"] == tests)


def table(rows: list[Row], reasons: dict[str, str]) -> Table:
    """Mutants, killed and survived of every module, and of all."""
    modules = sorted({row["path"] for row in rows})
    lines = [_line(m, [r for r in rows if r["path"] == m], reasons) for m in modules]
    header = ("module", "mutants", "killed", "of these by time", "survived")
    header += ("of these equivalent", "killed of those not equivalent")
    return Table(header, (*lines, _line("all", rows, reasons)))


def _line(name: str, rows: list[Row], reasons: dict[str, str]) -> tuple[str, ...]:
    count = Counter(row["outcome"] for row in rows)
    killed = sum(count[x] for x in DETECTED)
    survived = len(rows) - killed
    same = sum(r["outcome"] not in DETECTED and r["key"] in reasons for r in rows)
    share = f"{killed / (len(rows) - same):.0%}" if len(rows) > same else "–"
    numbers = (len(rows), killed, count["timeout"], survived, same)
    return (name, *map(str, numbers), share)


def page(rows: list[Row], reasons: dict[str, str], command: str, drawn: int) -> str:
    """The table, and every survivor as a patch."""
    parts = ["# Mutants\n", markdown_table(table(rows, reasons)), f"`{command}`\n"]
    if len(rows) < drawn:
        parts.append(
            f"{drawn - len(rows)} of {drawn} that were drawn are still open.\n"
        )
    left = [row for row in rows if row["outcome"] not in DETECTED]
    for title, wanted in (("Survivors", False), ("Equivalent", True)):
        chosen = [row for row in left if (row["key"] in reasons) is wanted]
        parts.append(f"## {title}: {len(chosen)}\n")
        for row in sorted(chosen, key=lambda r: (r["path"], r["diff"])):
            reason = f": {reasons[row['key']]}" if wanted else ""
            parts.append(f"`{row['path']}` ({row['key']}){reason}\n")
            parts.append(f"```diff\n{row['diff']}\n```\n")
    return "\n".join(parts)


def main() -> None:
    """Run a campaign and write its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--seed", type=int, default=1, help="which mutants are drawn")
    parser.add_argument("--count", type=int, default=400, help="how many")
    parser.add_argument("--only", nargs="*", default=(), help="modules or folders")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then stop")
    given = parser.parse_args()
    mutants = drawn(given.seed, given.count, tuple(given.only))
    rows = campaign(mutants, given.minutes)
    given.out.mkdir(parents=True, exist_ok=True)
    known = given.out / "equivalent.toml"
    reasons = tomllib.loads(known.read_text()) if known.exists() else {}
    command = f"{COMMAND} --seed {given.seed} --count {given.count}"
    command += " --only " + " ".join(given.only) if given.only else ""
    (given.out / "table.md").write_text(page(rows, reasons, command, len(mutants)))
    found = table(rows, reasons)
    record = {"provenance": provenance(command=command), "header": found.header}
    write_results(given.out / "results.json", {**record, "rows": found.rows})
    print(markdown_table(found))


if __name__ == "__main__":
    main()
