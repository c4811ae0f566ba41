"""Does the diagnosis still name the fault where the arm moves as it does at work?

Logs of ``own_loop``, one fault of each kind: from pose to pose with rests, one joint
after the other, and the same path in each log. A table of kinds and motions appears,
with the outcomes of ``own_loops``.

    python experiments/own_loops_motions.py --arm ur5 --seed 9
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from outputs import command_line
from own_fault import KINDS
from own_loops import by_condition, outcome, run, write_report
from own_motion import Make, again, visits
from rich.console import Console

from hybrid.plant import random_fourier

MOTIONS = "pose to pose", "joint by joint", "one path"


def motion(name: str) -> Make:
    """What makes motions of a name, for the logs of one plant."""
    if name == "one path":
        return again(random_fourier)
    return partial(visits, one=name == "joint by joint")


def answers(arm: str, seed: int, kind: str) -> list[dict[str, Any]]:
    """Log one fault in each motion, and diagnose it."""
    found = [run(arm, (kind,), seed, motion=motion(name)) for name in MOTIONS]
    return [x | {"outcome": outcome(x)} for x in found]


def main() -> None:
    """Run all kinds, print the table, write the report."""
    parser = command_line(__doc__, "own_loops_motions")
    parser.add_argument("--arm", default="ur5")
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--workers", type=int, default=2)
    args, console, runs = parser.parse_args(), Console(width=160), []
    with ProcessPoolExecutor(args.workers) as pool:
        for found in pool.map(partial(answers, args.arm, args.seed), KINDS):
            runs.append(found)
            said = [x["outcome"] for x in found]
            console.print(found[0]["true"][0], said, highlight=False)
    table, summary = by_condition(runs, MOTIONS, args.arm)
    command = f"python experiments/own_loops_motions.py --arm {args.arm}"
    write_report(args.out, table, summary, f"{command} --seed {args.seed}", runs)


if __name__ == "__main__":
    main()
