"""Are both faults of a loop found that has two?

Pairs of the faults of ``own_loops``, drawn at random, each at a joint of its own or at
the same. A number beside each fault says how many times the noise it adds to the gap,
alone: some leave next to no trace, on that arm, at that joint. All pairs are counted,
and those apart of which both are as large as the noise.

    python experiments/own_loops_pairs.py --arms models/scara.xml,ur5,z1 --seed 41
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from outputs import command_line
from own_fault import IN_COMMAND, KINDS
from own_loops import counted, run, write_report
from rich.console import Console

from hybrid.report import Table


def outcome(found: dict[str, Any]) -> str:
    """Which of two faults are found, and what else is named."""
    named = found["named"]
    there = [
        kind for kind, joint in found["true"]
        if any(kind in x["class"] and joint in x["joints"] for x in named)
    ]  # fmt: skip
    kinds = {kind for kind, _ in found["true"]}
    false = [x["effect"] for x in named if not kinds & {*x["class"]}]
    word = ("neither", f"only {''.join(there)}", "both")[len(there)]
    return word + "".join(f", and {x}" for x in false)


def pair(job: tuple[str, tuple[str, ...], int]) -> dict[str, Any]:
    """Diagnose two faults on an arm."""
    found = run(*job)
    return found | {"outcome": outcome(found)}


def draw(arms: list[str], count: int, seed: int) -> Iterator[tuple[Any, ...]]:
    """Arm, kinds and seed of each pair."""
    kinds = [k for k in KINDS if k not in ("none", *IN_COMMAND)]
    rng = np.random.default_rng(seed)
    for k in range(count):
        both = rng.choice(kinds, 2, replace=False)
        yield arms[k % len(arms)], tuple(map(str, both)), seed + k


def main() -> None:
    """Diagnose all pairs, print the table, write the report."""
    parser = command_line(__doc__, "own_loops_pairs")
    parser.add_argument("--arms", default="models/scara.xml,ur5,z1")
    parser.add_argument("--count", type=int, default=36)
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument("--workers", type=int, default=2)
    args, console, runs = parser.parse_args(), Console(width=160), []
    jobs = list(draw(args.arms.split(","), args.count, args.seed))
    with ProcessPoolExecutor(args.workers) as pool:
        for found in pool.map(pair, jobs):
            console.print(found["arm"], found["true"], found["outcome"])
            runs.append(found)
    rows = [
        (r["arm"], *(f"{' at '.join(x)} ({size:.1f})" for x, size in
                     zip(r["true"], r["sizes"], strict=True)), r["outcome"])
        for r in runs
    ]  # fmt: skip
    table = Table(
        ("arm", "one", "the other", "found"), tuple(rows),
        "What is found of two faults at once", words=True,
    )  # fmt: skip
    large = [r for r in runs if min(r["sizes"]) >= 1.0]
    summary = f"All {len(runs)}: {count(runs)}\n\n"
    summary += f"Both as large as the noise, {len(large)}: {count(large)}"
    command = "python experiments/own_loops_pairs.py"
    command += f" --arms {args.arms} --count {args.count} --seed {args.seed}"
    write_report(args.out, table, summary, command, runs)


def count(runs: Sequence[dict[str, Any]]) -> str:
    """How often both faults, one or none were found, and something false, in words."""
    found = Counter(r["outcome"].split(" ")[0].strip(",") for r in runs)
    found["something false"] = sum("and" in r["outcome"] for r in runs)
    return counted(found)


if __name__ == "__main__":
    main()
