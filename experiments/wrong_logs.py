"""Which wrong logs are told, and which right ones are taken for wrong?

Logs of simulated arms, whose numbers are off by a third from their files, and of a
real UR10 if given, written in every way of ``tests/wrong_logs.py``, at other joints for
each seed. A table of kinds and arms appears: how many were refused with the right cause
and column (right), refused for another (caught), warned of, or missed. Below it, what
was said of logs that are right, on eight arms.

    python experiments/wrong_logs.py --real ROBOT.urdf LOG.csv --out OUT
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from pathlib import Path
from time import process_time

import numpy as np
from blind.robots import load_arm
from own_loops import write_report
from right_logs import made, outcome, said_of_right, wrong_logs

from hybrid.errors import HybridWarning
from hybrid.recording import read
from hybrid.report.table import Table
from hybrid.robot import Robot

ARMS = ("models/scara.xml", "ur5", "models/coman_like.xml")
HEALTHY = (*ARMS, "models/planar.xml", "ur10", "panda", "xarm7", "z1")


def told(arms: dict[str, list[tuple]], runs: list) -> Table:
    """Outcomes of every kind on every arm."""
    rows = []
    for kind, way in made.WRONG.items():
        cells = []
        for arm, logs in arms.items():
            counts: Counter[str] = Counter()
            for robot, log, small, (i, j) in logs:
                source = small if way.small else log
                if source is not None and robot.size >= way.joints:
                    said = outcome(robot, source, way, i, j)
                    counts[said] += 1
                    runs.append({"kind": kind, "arm": arm, "joints": [i, j]})
                    runs[-1]["outcome"] = said
            cells.append(", ".join(f"{n} {x}" for x, n in counts.most_common()) or "-")
        rows.append((kind, *cells))
    return Table(("", *arms), tuple(rows), "What is said of wrong logs", words=True)


def main() -> None:
    """Make all logs, inspect them, print and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--real", nargs=2, metavar=("ROBOT", "LOG"), default=())
    parser.add_argument("--out", type=Path, default=Path("out/wrong_logs"))
    args, runs = parser.parse_args(), []
    warnings.simplefilter("ignore", HybridWarning)
    arms = {Path(a).stem: wrong_logs(load_arm(a), args.seeds) for a in ARMS}
    if args.real:
        robot = Robot.load(args.real[0])
        log, rng = read(args.real[1], joints=robot.joints), np.random.default_rng(0)
        pairs = rng.permuted(np.tile(range(robot.size), (args.seeds, 1)), axis=1)
        arms["real arm"] = [(robot, log, None, sorted(p[:2].tolist())) for p in pairs]
    table, start = told(arms, runs), process_time()
    said = said_of_right([load_arm(a) for a in HEALTHY], args.seeds // 2)
    count, cpu = sum(said["logs"].values()), process_time() - start
    counts = Counter(r["outcome"] for r in runs)
    summary = (
        f"{dict(counts)}. Right logs: {count}, in {cpu:.0f} CPU s with their making; "
        f"errors: {said['errors'] or 'none'}; warnings: {said['warnings'] or 'none'}."
    )
    real = f" --real {' '.join(Path(x).name for x in args.real)}" if args.real else ""
    command = f"python experiments/wrong_logs.py{real}"
    write_report(args.out, table, summary, f"{command} --seeds {args.seeds}", runs)


if __name__ == "__main__":
    main()
