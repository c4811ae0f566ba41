"""An effect withheld from the library, then given back: what is said of one plant?

The loops of ``own_loops``, each diagnosed twice: with the true effect left out of the
library, where it is right to abstain or to name one that is declared its equivalent,
and with it. A table has a line for each plant: the gap of its joint on motions that no
step has seen beside its noise, what is said and what is left of it, without and with
the effect. To say nothing of a gap that stands above its noise is a miss. With
--class the equivalents are left out as well: only to abstain is right then.

    python experiments/own_loops_withheld.py --arms models/scara.xml,ur5 --seed 301
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from blind.score import EQUIVALENT
from outputs import command_line
from own_fault import IN_COMMAND, KINDS
from own_loops import counted, outcome, run, short, write_report
from rich.console import Console

from hybrid.report import Table

Job = tuple[str, int, str, tuple[str, ...]]  # arm, seed, fault, what else is left out
HEADS = ("arm", "fault", "gap (noise)", "withheld", "left", "given back", "left")


def without(found: dict[str, Any]) -> str:
    """Whether an answer without the true effect at hand is right."""
    ((kind, _),), named = found["true"], found["named"]
    if not named:
        return str(found["verdict"])
    first = named[0]["effect"]
    word = "equivalent" if first in EQUIVALENT.get(kind, ()) else "another"
    return f"{word} ({first})"


def both(job: Job) -> dict[str, Any]:
    """Diagnose one fault without the effect of that name, and with it."""
    arm, seed, kind, more = job
    withheld = run(arm, (kind,), seed, without=(kind, *more))
    added = run(arm, (kind,), seed)
    return {
        "withheld": withheld | {"outcome": without(withheld)},
        "added": added | {"outcome": outcome(added)},
    }


def line(pair: dict[str, Any]) -> tuple[str, ...]:
    """One plant's line of the table."""
    withheld, added = pair["withheld"], pair["added"]
    ((kind, joint),) = withheld["true"]
    j = list(withheld["joints"]).index(joint)

    def at(found: dict[str, Any], what: str) -> str:
        value = found["unseen"] and found["unseen"][what][j]
        return "–" if value is None else f"{value:.3g}"

    gap = f"{at(added, 'before')} ({at(added, 'noise')})"
    said = [(x["outcome"], at(x, "after")) for x in (withheld, added)]
    return (withheld["arm"], f"{kind}, {joint}", gap, *said[0], *said[1])


def left_over(pairs: Sequence[dict[str, Any]]) -> str:
    """What other effects leave at the joint, over what the true one leaves, sorted.

    At 1 the recordings do not tell them apart.
    """
    ratios = []
    for withheld, added in ((p["withheld"], p["added"]) for p in pairs):
        if withheld["outcome"].startswith("another"):
            j = list(withheld["joints"]).index(withheld["true"][0][1])
            ratios.append(withheld["unseen"]["after"][j] / added["unseen"]["after"][j])
    said = ", ".join(f"{x:.2f}" for x in sorted(ratios)) or "–"
    return f"Left by another effect, over what the true one leaves: {said}"


def main() -> None:
    """Diagnose all kinds on all arms twice, print the table, write the report."""
    parser = command_line(__doc__, "own_loops_withheld")
    parser.add_argument("--arms", default="models/scara.xml,ur5")
    parser.add_argument("--seed", type=int, default=301)
    parser.add_argument("--class", action="store_true", dest="whole_class")
    parser.add_argument("--workers", type=int, default=2)
    args, console, pairs = parser.parse_args(), Console(width=160), []
    kinds = [k for k in KINDS if k not in ("none", *IN_COMMAND)]
    alike = EQUIVALENT if args.whole_class else {}
    jobs = [
        (arm, args.seed, kind, tuple(sorted(alike.get(kind, ()))))
        for arm in args.arms.split(",")
        for kind in kinds
    ]
    with ProcessPoolExecutor(args.workers) as pool:
        for pair in pool.map(both, jobs):
            pairs.append(pair)
            console.print(*line(pair), highlight=False)
    table = Table(
        HEADS, tuple(map(line, pairs)),
        "One fault a plant: what is said with its effect "
        + "and all equivalents " * args.whole_class
        + "withheld from the library, "
        "and with it given back; RMS at its joint on unseen motions, N·m",
        words=True,
    )  # fmt: skip
    counts = []
    for part, title in (("withheld", "Withheld"), ("added", "Given back")):
        count = Counter(short(p[part]["outcome"]) for p in pairs)
        counts.append(f"{title}: {counted(count)}")
    counts.append(left_over(pairs))
    times = [p[part]["cpu_s"] for p in pairs for part in ("withheld", "added")]
    counts.append(f"CPU: mean {sum(times) / len(times):.1f} s, most {max(times):.0f} s")
    command = "python experiments/own_loops_withheld.py"
    command += f" --arms {args.arms} --seed {args.seed}" + " --class" * args.whole_class
    write_report(args.out, table, "\n\n".join(counts), command, pairs)


if __name__ == "__main__":
    main()
