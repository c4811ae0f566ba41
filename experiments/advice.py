"""Does the advised experiment split the candidates that the recordings could not?

The COMAN-like arm with one effect is recorded in one short and slow motion, so that
other effects explain it as well. The diagnosis advises experiments; the true arm runs
each, and both recordings are diagnosed together. A table of all pairs of the true
effect and another one that it could not be told from appears: whether an experiment is
advised, whether the pair is in one class no more, and rightly so: the true effect is
still named.

    python experiments/advice.py --seeds 3
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from advice_cases import CASES, MODEL, class_at, recorded, repeated, true_effect
from advice_report import write_report
from outputs import command_line
from rich.console import Console

from hybrid import Effect, Robot
from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.diagnose import examine


def pairs_of(robot: Robot, true: Effect, seed: int) -> Iterator[dict[str, Any]]:
    """Pairs of the true effect and a rival, before and after what is advised."""
    rng = np.random.default_rng([seed, sum(map(ord, true.id)), *true.joints])
    logs = recorded(robot, true, rng)
    first, name = examine(robot, logs), robot.joints[true.joints[0]]
    before = class_at(first, name)
    if true.id not in before:
        return
    with TemporaryDirectory() as folder:
        advised, after = advise(first, rng, directory=folder), dict[str, set[str]]()
        for rival in sorted(before - {true.id}):
            # The effect that was named may be another one of the class.
            about = [a for a in advised if {true.id, rival} <= {*a.splits}]
            row = {"true": true.id, "rival": rival, "joint": name, "seed": seed}
            row |= {"class": sorted(before), "advice": "", "runs": False}
            row |= {"split": False, "right": False}
            for a in about[:1]:
                row |= {"advice": a.experiment, "separation": a.separation}
                if a.file and a.file not in after:
                    then = repeated(robot, true, logs, a, Path(folder))
                    after[a.file] = class_at(then, name)
                left = after.get(a.file, before)
                split = not {true.id, rival} <= left
                row |= {"runs": bool(a.file), "split": split, "after": sorted(left)}
                row["right"] = split and true.id in left
            yield row


def main() -> None:
    """Measure all cases, say what came out, write the report."""
    parser = command_line(__doc__, "advice")
    parser.add_argument("--seeds", type=int, default=3)
    args, console, pairs = parser.parse_args(), Console(), list[dict[str, Any]]()
    robot = Robot.load(MODEL)
    for seed in range(args.seeds):
        for case in CASES:
            pairs += pairs_of(robot, true_effect(robot, *case), seed)
            console.print(*case, seed, len(pairs))
    command = f"python experiments/advice.py --seeds {args.seeds}"
    console.print(write_report(args.out, pairs, command))


if __name__ == "__main__":
    main()
