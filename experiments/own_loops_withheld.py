"""Is anything named that is not there, if the fault of a loop is in no library?

The loops of ``own_loops``: each effect is left out of the library where it is the
fault. Right is to abstain, or to name one that is declared its equivalent.

    python experiments/own_loops_withheld.py --arms models/scara.xml,ur5 --seed 31
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from blind.score import EQUIVALENT
from outputs import command_line
from own_fault import IN_COMMAND, KINDS
from own_loops import counted, run, write_report
from rich.console import Console

from hybrid.report import Table


def outcome(found: dict[str, Any]) -> str:
    """Whether an answer without the true effect at hand is right."""
    ((kind, _),), named = found["true"], found["named"]
    if not named:
        return str(found["verdict"])
    first = named[0]["effect"]
    word = "equivalent" if first in EQUIVALENT.get(kind, ()) else "named"
    return f"{word} ({first})"


def withhold(arm: str, seed: int, kind: str) -> dict[str, Any]:
    """Diagnose one fault without the effect of that name."""
    found = run(arm, (kind,), seed, without=(kind,))
    return found | {"outcome": outcome(found)}


def main() -> None:
    """Withhold all kinds on all arms, print the table, write the report."""
    parser = command_line(__doc__, "own_loops_withheld")
    parser.add_argument("--arms", default="models/scara.xml,ur5")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--workers", type=int, default=2)
    args, console = parser.parse_args(), Console(width=160)
    arms, runs = args.arms.split(","), []
    kinds = [k for k in KINDS if k not in ("none", *IN_COMMAND)]
    with ProcessPoolExecutor(args.workers) as pool:
        for arm in arms:
            for found in pool.map(partial(withhold, arm, args.seed), kinds):
                console.print(arm, found["true"], found["outcome"], highlight=False)
                runs.append(found)
    outcomes = [r["outcome"] for r in runs]
    by_arm = [outcomes[k :: len(kinds)] for k in range(len(kinds))]
    table = Table(
        ("", *(Path(arm).stem for arm in arms)),
        tuple((kind, *row) for kind, row in zip(kinds, by_arm, strict=True)),
        "What is said of one fault of each kind, its effect withheld from the library",
        words=True,
    )
    count = Counter(x.split(" (")[0] for x in outcomes)
    command = "python experiments/own_loops_withheld.py"
    command += f" --arms {args.arms} --seed {args.seed}"
    write_report(args.out, table, counted(count), command, runs)


if __name__ == "__main__":
    main()
