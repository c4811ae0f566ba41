"""How often the diagnosis is right on plants whose truth it is not told.

A table of shares with intervals appears, beside simpler methods, for the arm that
thresholds were tuned on and for arms that they were never tuned on, and a confusion
matrix: which effect is named for which. Cases that an earlier run of the same code has
answered are not run again.

    python experiments/blind_diagnosis.py --cases 600 --seed 1
    python experiments/blind_diagnosis.py --cases 168 --strata independent
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from blind.case import STRATA, TUNED, Case, plan
from blind.run import run_cases
from blind.tables import by_robot, targets_table, write_benchmark
from outputs import command_line
from rich.console import Console

from hybrid.report import provenance, terminal_table

ROOT = Path(__file__).parents[1]
LOG = ROOT / "build" / "blind_diagnosis.jsonl"
KNOWN = tuple(f"models/{name}.xml" for name in TUNED)
NEW = ("ur5", "panda", "models/scara.xml", "z1", "xarm7", "ur10")


def cases_of(count: int, seed: int, strata: Sequence[str] | None = None) -> list[Case]:
    """Half of the cases on robots tuned on, half on others, alternating."""
    halves = (
        plan(KNOWN, count - count // 2, seed=seed, strata=strata),
        plan(NEW, count // 2, seed=seed, strata=strata),
    )
    ranked = [
        (k / len(half), case)
        for half in halves
        for k, case in enumerate(half)
    ]  # fmt: skip
    return [case for _, case in sorted(ranked, key=lambda x: x[0])]


def main() -> None:
    """Run the cases, print the table, write the report."""
    parser = command_line(__doc__, "blind_diagnosis")
    parser.add_argument("--cases", type=int, default=600)
    parser.add_argument("--seed", type=int, nargs="+", default=[1])
    parser.add_argument("--strata", nargs="+", choices=STRATA, metavar="STRATUM")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scheduler", help="address of a Dask scheduler")
    parser.add_argument("--log", type=Path, default=LOG)
    args, console = parser.parse_args(), Console(width=200)
    each = [cases_of(args.cases, seed, args.strata) for seed in args.seed]
    rows = run_cases(
        [case for cases in each for case in cases],
        args.log,
        workers=args.workers,
        scheduler=args.scheduler,
        tell=lambda row: console.print(row["key"], row.get("verdict", "no answer")),
    )
    command = f"python experiments/blind_diagnosis.py --cases {args.cases} --seed "
    command += " ".join(map(str, args.seed))
    if args.strata:
        command += f" --strata {' '.join(args.strata)}"
    write_benchmark(rows, args.out, tuned=TUNED, how=provenance(command=command))
    console.print(terminal_table(targets_table(by_robot(rows, TUNED))))


if __name__ == "__main__":
    main()
