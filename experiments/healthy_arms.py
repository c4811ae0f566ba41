"""Is anything named on an arm to which nothing has happened?

Loops of ``own_loops`` without a fault, on several arms: links and friction of the file
are off by up to 2 %. Each arm is diagnosed twice: against its file, and, by four more
logs, against the model that was identified from the first four. What is named is
false. A table has a line for each arm, with the verdicts.

    python experiments/healthy_arms.py --seeds 10 --first 601
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

from blind.robots import load_arm
from outputs import command_line
from own_loop import OwnLoop
from own_loops import RECORDINGS, counted, named, write_report
from rich.console import Console

from hybrid import Diagnosis, diagnose, identify
from hybrid.errors import HybridWarning
from hybrid.report import Table
from hybrid.shown import plain

ARMS = "models/scara.xml", "ur5", "z1", "panda", "models/coman_like.xml"
AGAINST = "file", "model"


def answers(job: tuple[str, int]) -> dict[str, Any]:
    """Diagnose one arm against its file, and against its model."""
    arm, seed = job
    loop = OwnLoop(load_arm(arm), ("none",), seed)
    first, then = ([loop.record() for _ in range(RECORDINGS)] for _ in AGAINST)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        known = identify(loop.robot, first).model
        found = diagnose(loop.robot, first), diagnose(known, then)
    said = map(answer, found)
    return {
        "arm": Path(arm).stem,
        "seed": seed,
        **dict(zip(AGAINST, said, strict=True)),
    }


def answer(found: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says."""
    unseen = found.unseen and plain(asdict(found.unseen))
    return {"verdict": found.verdict, "named": named(found), "unseen": unseen}


def line(runs: Sequence[dict[str, Any]], against: str) -> str:
    """Verdicts, and what was named."""
    text = counted(Counter(r[against]["verdict"] for r in runs))
    false = [x["effect"] for r in runs for x in r[against]["named"]]
    return f"{text} ({', '.join(false)})" if false else text


def main() -> None:
    """Diagnose all arms, print the table, write the report."""
    parser = command_line(__doc__, "healthy_arms")
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=601)
    parser.add_argument("--workers", type=int, default=2)
    args, console, runs = parser.parse_args(), Console(width=160), []
    seeds = range(args.first, args.first + args.seeds)
    with ProcessPoolExecutor(args.workers) as pool:
        for found in pool.map(answers, product(args.arms.split(","), seeds)):
            runs.append(found)
            said = [line([found], x) for x in AGAINST]
            console.print(found["arm"], found["seed"], *said, highlight=False)
    rows = []
    for arm in dict.fromkeys(r["arm"] for r in runs):
        own = [r for r in runs if r["arm"] == arm]
        rows.append((arm, *(line(own, x) for x in AGAINST)))
    table = Table(
        ("arm", "against its file", "against its model"), tuple(rows),
        "What is said of arms to which nothing has happened", words=True,
    )  # fmt: skip
    false = [sum(bool(r[x]["named"]) for r in runs) for x in AGAINST]
    summary = f"Something named: {false[0]} and {false[1]} of {len(runs)}."
    command = f"python experiments/healthy_arms.py --arms {args.arms}"
    command += f" --seeds {args.seeds} --first {args.first}"
    write_report(args.out, table, summary, command, runs)


if __name__ == "__main__":
    main()
