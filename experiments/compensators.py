"""Which learner suits what physics leaves: one protocol, one table.

A table appears: learners of the torque that a rigid body with rotors, fitted by plain
least squares, leaves at joints of the simulated COMAN-like arm (all friction), scored
on motions that none has seen: RMS error over that without a learner, rise of the
log-likelihood of a sample over that of a Gaussian of constant size [nat], share of
samples in the 90 % interval, seconds to train, microseconds a sample to run (alone, and
in a batch), numbers to store. Medians over seeds and joints.

    python experiments/compensators.py --seeds 3
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from coman import simulate_run
from compensator_choice import choice
from compensator_learners import COLUMNS, LEARNERS, samples, score
from outputs import captioned, command_line, write_tables
from rich.console import Console

from hybrid import identify
from hybrid.errors import HybridWarning
from hybrid.report import Table, terminal_table

JOINTS = (0, 2, 3)


def report(out: Path, values: np.ndarray, command: str, count: int) -> Table:
    """Write results and table; values are (seeds · joints, learners, columns)."""
    middle, low, high = (f(values, axis=0) for f in (np.median, np.min, np.max))
    rows = []
    for k, name in enumerate(LEARNERS):
        spread = f"{low[k, 0]:.2f}–{high[k, 0]:.2f}"
        rows.append((name, *(f"{x:.3g}" for x in middle[k]), spread))
    caption = f"Medians over {count} seeds and {len(JOINTS)} joints; times of one core"
    table = Table(("", *COLUMNS, "error, lowest–highest"), tuple(rows), caption)
    content = {"columns": COLUMNS, "values": values, "names": [*LEARNERS]}
    text = f"{captioned(table)}\n{choice(values)}\n"
    write_tables(out, text, command, **content)
    return table


def main() -> None:
    """Measure, print the table, write the report."""
    parser = command_line(__doc__, "compensators")
    parser.add_argument("--seeds", type=int, default=3)
    args, console, found = parser.parse_args(), Console(width=120), []
    count = args.seeds
    command = f"python experiments/compensators.py --seeds {count}"
    for seed in range(count):
        run = simulate_run(seed, trajectories=3, duration=8.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            plain = identify(run.robot, run.fitting, stages=("rigid",)).model
        rotors = tuple(e for e in plain.effects if e.id == "armature")
        rigid = replace(plain, effects=rotors, simpler={})
        for j in JOINTS:
            rows = []
            for learn, history in LEARNERS.values():
                both = [
                    samples(rigid, x, j, history) for x in (run.fitting, run.scoring)
                ]
                rows.append(score(learn, *both))
            found.append(rows)
    console.print(terminal_table(report(args.out, np.array(found), command, count)))


if __name__ == "__main__":
    main()
