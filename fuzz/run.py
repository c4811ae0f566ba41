"""What becomes of a million damaged files: taken, or refused in one line, and no more.

Every reader gets inputs that grow from files that it takes, guided by coverage where
the package atheris is installed (``make fuzz`` installs it). A finding is a traceback,
an input that takes more than 5 s of processor time, a file left in the working folder,
or a process that was taken down. Readers run one after the other, at low priority.

    python fuzz/run.py --inputs 1000000 --out reports/fuzz
    python fuzz/run.py --inputs 60000 --out here --only HDF5 MATLAB
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import resource
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from readers import READERS

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results

HEADER = ("reader", "inputs", "taken", "refused", "branches", "slowest, ms", "findings")
MOST_STARTS = 5  # of one reader, which a crash ends


def fuzzed(name: str, inputs: int, seed: int) -> dict:
    """Counts of one reader; crashes are findings as well."""
    total = {"inputs": 0, "taken": 0, "refused": 0, "left": 0}
    slowest, coverage, findings = 0.0, 0, {}
    for start in range(MOST_STARTS):
        with TemporaryDirectory() as folder:
            more = [name, str(inputs - total["inputs"]), str(seed + start), folder]
            command = [sys.executable, str(Path(__file__).with_name("one.py")), *more]
            done = subprocess.run(command, capture_output=True, preexec_fn=_politely)
            path = Path(folder) / "counts.json"
            found = json.loads(path.read_text()) if path.exists() else {}
            last = Path(folder) / "last"
            data = last.read_bytes() if last.exists() else b""
        for key in total:
            total[key] += found.get(key, 0)
        slowest = max(slowest, found.get("slowest", 0.0))
        findings |= found.get("findings", {})
        branches = re.findall(rb"cov: (\d+)", done.stderr)
        coverage = max(coverage, *map(int, branches), 0, 0)
        if total["inputs"] >= inputs:
            break
        findings[f"exit {done.returncode}"] = (
            f"{done.stderr[-300:]!r} of {data[:200]!r}"
        )
    if total["left"]:
        findings["files left"] = str(total["left"])
    return {**total, "branches": coverage, "slowest": slowest, "findings": findings}


def _politely() -> None:
    os.nice(10)


def write(folder: Path, found: dict, args: argparse.Namespace) -> None:
    """Write the table of the readers that are done."""
    rows = []
    for name, one in found.items():
        numbers = [f"{one[x]:,}" for x in ("inputs", "taken", "refused", "branches")]
        slowest, wrong = f"{1000 * one['slowest']:.0f}", len(one["findings"])
        rows.append((name, *numbers, slowest, str(wrong or "–")))
    guided = importlib.util.find_spec("atheris") is not None
    command = f"python fuzz/run.py --inputs {args.inputs} --out {folder}"
    if args.only != [*READERS]:
        command += " --only " + " ".join(map(shlex.quote, args.only))
    how = provenance(command=command, seed=args.seed, settings={"guided": guided})
    write_results(folder / "results.json", {"readers": found, "provenance": how})
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    minutes = (spent.ru_utime + spent.ru_stime) / 60
    words = f"`{command}`, {minutes:.0f} min of processor time, "
    words += "guided by coverage" if guided else "random mutations"
    table = markdown_table(Table(HEADER, tuple(rows)))
    with atomic_path(folder / "table.md") as path:
        path.write_text(f"{table}\n{words}\n", encoding="utf-8")


def main() -> None:
    """Fuzz every reader and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of all readers")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=READERS, default=[*READERS])
    args = parser.parse_args()
    each, found = -(-args.inputs // len(args.only)), {}
    for name in args.only:
        found[name] = fuzzed(name, each, args.seed)
        print(name, found[name], flush=True)
        write(args.out, found, args)
    sys.exit(any(one["findings"] for one in found.values()))


if __name__ == "__main__":
    main()
