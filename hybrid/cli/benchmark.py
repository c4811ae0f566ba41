"""``hybrid benchmark``: how good an answer is, on plants whose truth is sealed."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.cli.options import (
    add_common,
    check_outputs,
    count,
    names,
    record,
    whole,
    write_record,
)

if TYPE_CHECKING:
    from hybrid.cli.screen import Screen

HELP = """diagnose plants whose truth is sealed, and score the answers
makes plants with effects that the diagnosis is not told, in a process of its own, and
writes DIR/tables.md (shares with 95 % intervals, beside simpler methods),
DIR/results.json, DIR/confusion.png (which effect is named for which) and
DIR/cases.jsonl. A case takes about 15 s; a run that was interrupted goes on where it
stopped. Effects of --effects-from may be named, but are in no plant.

--json: what is in results.json.

example:
  hybrid benchmark diagnose --cases 60 --robots models/coman_like.xml,ur5 --out blind"""

_ROBOTS = "models/coman_like.xml"


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("what", choices=("diagnose",))
    parser.add_argument("--cases", type=count, default=60, metavar="N")
    parser.add_argument(
        "--robots",
        type=names,
        default=(_ROBOTS,),
        metavar="A,B",
        help="robot files or names, as ur5, ur10, panda, xarm7, z1 of the package "
        f"example-robot-data (default {_ROBOTS})",
    )
    parser.add_argument(
        "--strata",
        type=names,
        metavar="A,B",
        help="kinds of plants: single, withheld, none, pair, triple, unknown, "
        "independent, poor, command (default: all)",
    )
    parser.add_argument("--seed", type=whole, default=0, metavar="N")
    parser.add_argument("--workers", type=count, default=1, metavar="N")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    add_common(parser)


def run(args: Namespace, screen: Screen) -> None:
    """Run the cases, one line each, and show the table of targets."""
    from hybrid.benchmark.case import TUNED, plan
    from hybrid.benchmark.run import run_cases
    from hybrid.benchmark.tables import by_robot, targets_table, write_benchmark
    from hybrid.report import numbers_table

    cases = plan(args.robots, args.cases, seed=args.seed, strata=args.strata)
    written = ("tables.md", "results.json", "confusion.png", "cases.jsonl")
    files = [path for name in args.robots if (path := Path(name)).is_file()]
    check_outputs([*(args.out / name for name in written), args.json], files)
    how = record(args, files) | {"command": _command(args)}
    with screen.working(f"diagnosing {len(cases)} plants"):
        rows = run_cases(
            cases,
            args.out / "cases.jsonl",
            workers=args.workers,
            tell=lambda row: screen.say(verdict_line(row)),
        )
    content = write_benchmark(rows, args.out, tuned=TUNED, how=how)
    write_record(args, how, content)
    screen.show_numbers(numbers_table(targets_table(by_robot(rows, TUNED))))


def verdict_line(row: dict[str, Any]) -> str:
    """One case in a line: what was true, and what was said."""
    for word in ("skipped", "crashed"):
        if word in row:
            return f"{row['key']}: {word}: {row[word]}"
    true = [" ".join([e["effect"], *e["joints"]]) for e in row["truth"]["effects"]]
    said = [" ".join(x) for x in row["named"]]
    return (
        f"{row['key']}: {'; '.join(true) or 'no gap'} → {row['verdict']}: "
        f"{'; '.join(said) or 'nothing'}"
    )


def _command(args: Namespace) -> str:
    strata = f" --strata {','.join(args.strata)}" if args.strata else ""
    return (
        f"hybrid benchmark diagnose --cases {args.cases} --robots "
        f"{','.join(args.robots)}{strata} --seed {args.seed}"
    )
