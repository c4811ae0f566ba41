"""What a log's measured speed is worth, beside differentiated position.

Two tables appear. On simulated logs, whose motion is known: error of speed,
acceleration and held-out torque of plain weighted least squares with a measured speed
over the same without, for speeds of many kinds. On logs of real arms: the held-out RMS
torque error of plain weighted least squares, from position alone, with speed and
acceleration from the measured speed alone, and from both, as this package does it.

    python experiments/measured_speed.py [--data DATA_FOLDER] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import numpy as np
from measured_speed_arms import arms_table
from measured_speed_logs import ENCODERS, SPEEDS
from measured_speed_simulated import simulated
from outputs import captioned, write_tables
from rich.console import Console

from hybrid import Robot
from hybrid.errors import HybridWarning
from hybrid.report import (
    Table,
    terminal_table,
)

ROOT = Path(__file__).parents[1]


def speeds_table(ratios: dict[str, np.ndarray]) -> Table:
    """Median over seeds and the worst of them, for each encoder."""
    titles = [f"{x}: {e}" for e in ENCODERS for x in ("v", "a", "τ")]
    rows = []
    for name, runs in ratios.items():
        middle = np.median(runs, axis=0).ravel()
        cells = zip(middle, runs.max(axis=0).ravel(), strict=True)
        rows.append((name, *(f"{m:.2f} ({w:.2f})" for m, w in cells)))
    caption = (
        "Error with a measured speed over that without: median (worst) of the seeds"
    )
    return Table(("speed", *titles), tuple(rows), caption)


def main() -> None:
    """Measure, print the tables, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, help="folder with a folder for each arm")
    parser.add_argument("--robot", default=str(ROOT / "models/coman_like.xml"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("measured_speed"))
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    runs = [simulated(Robot.load(args.robot), seed) for seed in range(args.seeds)]
    ratios = {name: np.array([run[name] for run in runs]) for name in SPEEDS}
    tables = [speeds_table(ratios)]
    if args.data:
        tables.append(arms_table(args.data))
    for table in tables:
        Console(width=150).print(terminal_table(table))
    command = f"python experiments/measured_speed.py --seeds {args.seeds}"
    command += " --data DATA_FOLDER" if args.data else ""
    write_tables(args.out, captioned(*tables), command, simulated=ratios)


if __name__ == "__main__":
    main()
