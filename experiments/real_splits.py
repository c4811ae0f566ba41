"""Does the diagnosis leave less than plain least squares, however a real log is split?

For each of three real arms a table appears with the torque that is left on samples that
no step has seen, with all effects found, divided by what least squares leaves, refitted
on the same training samples. A quarter of a log is few seconds: each quarter is held
out in turn. Means are geometric.

    python experiments/real_splits.py DATA_FOLDER
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from outputs import command_line, write_tables
from real_arms_data import ARMS, Arm

from hybrid import Robot, read_recordings
from hybrid.arrays import Array
from hybrid.diagnosis import diagnose
from hybrid.diagnosis.gap.gap import Gap
from hybrid.errors import HybridWarning
from hybrid.report import Table, markdown_table

QUARTERS = 4


def without(quarter: int, gap: Gap) -> NDArray[np.bool_]:
    """Training samples without one block of time, or log, of four; shape (M,)."""
    if gap.trajectory.max() + 1 >= QUARTERS:
        return np.asarray(gap.trajectory % QUARTERS != quarter)
    return np.asarray((gap.fold + gap.trajectory) % QUARTERS != quarter)


def ratios(arm: Arm, data: Path) -> Array:
    """What is left over what least squares leaves, shape (quarters, n)."""
    robot = Robot.load(data / arm.folder / "robot.urdf")
    read = read_recordings([data / arm.folder], joints=robot.joints)
    logs, found = [replace(x, source=Path(x.source).name) for x in read], []
    for quarter in range(QUARTERS):
        with patch.object(diagnose, "split", lambda gap, k=quarter: without(k, gap)):
            left = diagnose.examine(robot, logs, cutoff=arm.cutoff).diagnosis.unseen
        found.append(np.divide(left.after, left.least_squares))
        print(arm.name, quarter, np.round(found[-1], 2), flush=True)
    return np.array(found)


def mean(ratio: Array) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(ratio))))


def main() -> None:
    """Diagnose every arm four times, and write the report."""
    parser = command_line(__doc__, "real_splits")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    args, rows = parser.parse_args(), []
    warnings.simplefilter("ignore", HybridWarning)  # columns of the logs not needed
    command = "python experiments/real_splits.py DATA_FOLDER"
    left = {}
    for arm in ARMS:
        each = ratios(arm, args.data)
        left[arm.name] = each.tolist()
        for k, row in enumerate(each):
            rows.append(
                (arm.name, f"{k + 1}", *(f"{x:.2f}" for x in (*row, mean(row))))
            )
        joints = [mean(x) for x in each.T]
        rows.append((arm.name, "mean", *(f"{x:.2f}" for x in (*joints, mean(each)))))
        rows.append((arm.name, "worse", *(f"{sum(x > 1)}" for x in each.T), ""))
    header = "arm", "quarter held out", *(f"joint {j + 1}" for j in range(6)), "mean"
    lead = (__doc__ or "").split("\n\n")[1]
    text = f"{lead}\n\n{markdown_table(Table(header, tuple(rows)))}"
    write_tables(args.out, text, command, ratios=left)


if __name__ == "__main__":
    main()
