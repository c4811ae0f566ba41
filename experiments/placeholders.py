"""Does a file with too much friction get what it lacks, and nothing else?

Simulators' files often hold friction that was set so that they run well. Here it is 2
and 10 times that of the arm, in loops of ``own_loops`` without a fault. Right are
Coulomb and viscous friction at every joint, or their equivalents, and nothing besides.

    python experiments/placeholders.py --seeds 1 --first 7101
"""

from __future__ import annotations

import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from blind.robots import load_arm
from healthy_arms import ARMS, answer
from outputs import command_line
from own_loop import OwnLoop
from own_loops import RECORDINGS, write_report
from rich.console import Console

from hybrid import diagnose
from hybrid.errors import HybridWarning
from hybrid.report import Table

FACTORS = 2.0, 10.0
RIGHT = "coulomb", "viscous"


def found(job: tuple[str, int, float]) -> dict[str, Any]:
    """Diagnose one arm whose file has some times its friction."""
    arm, seed, factor = job
    loop = OwnLoop(load_arm(arm), ("none",), seed)
    logs, file = [loop.record() for _ in range(RECORDINGS)], loop.robot
    file = replace(
        file, frictionloss=factor * file.frictionloss, damping=factor * file.damping
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        said = answer(diagnose(file, logs))
    case = {"arm": Path(arm).stem, "seed": seed, "factor": factor}
    return case | {"joints": file.joints} | said


def row(run: dict[str, Any]) -> tuple[str, ...]:
    """Joints at which friction was found, and what was named besides."""
    places = {
        law: {j for x in run["named"] if law in x["class"] for j in x["joints"]}
        for law in RIGHT
    }
    right = [f"{len(x)} of {len(run['joints'])}" for x in places.values()]
    besides = [
        f"{x['effect']} at {', '.join(x['joints'])}"
        for x in run["named"] if not {*RIGHT} & {*x["class"]}
    ]  # fmt: skip
    named = "; ".join(besides) or "nothing"
    return run["arm"], str(run["seed"]), f"{run['factor']:g}", *right, named


def main() -> None:
    """Diagnose all arms, print the table, write the report."""
    parser = command_line(__doc__, "placeholders")
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=7101)
    parser.add_argument("--workers", type=int, default=2)
    args, console, runs = parser.parse_args(), Console(width=160), []
    seeds = range(args.first, args.first + args.seeds)
    with ProcessPoolExecutor(args.workers) as pool:
        for run in pool.map(found, product(args.arms.split(","), seeds, FACTORS)):
            runs.append(run)
            console.print(*row(run), highlight=False)
    header = "arm", "seed", "friction of the file", *RIGHT, "named besides"
    rows = tuple(map(row, runs))
    table = Table(header, rows, "What is said of files with too much friction")
    false = sum(r[-1] != "nothing" for r in rows)
    summary = f"Something besides friction: {false} of {len(runs)}."
    command = (
        f"python experiments/placeholders.py --arms {args.arms} --seeds {args.seeds} "
        f"--first {args.first}"
    )
    write_report(args.out, table, summary, command, runs)


if __name__ == "__main__":
    main()
