"""Three real arms: held-out torque error beside plain least squares.

A table appears for a UR10, a Stäubli TX40 and a KUKA KR300: RMS torque error on moving
samples that no fit has seen, at the rate of the log, beside the better of plain and
weighted least squares with linear friction, and beside each stage of the published
chain. The worst joint of our ladder is against the better of the two at that joint,
with the standard error of that change over the seconds that were held out. UR10 and
TX40 have one log each: every third block is held out, and each of the three ways to do
so is scored. The KR300 has two logs.

    python experiments/real_arms.py DATA_FOLDER
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from outputs import captioned, command_line, write_tables
from published_chain import beside, published_chain
from real_arms_data import ARMS, Arm, Score, held_out_squares
from real_arms_report import arm_table, ratio_figure
from rich.console import Console

from hybrid import Robot, identify, read_recordings, validate
from hybrid.errors import HybridWarning
from hybrid.report import (
    save_figure,
    terminal_table,
)
from hybrid.signals import motion_from_recording


def measure(arm: Arm, data: Path) -> Iterator[Score]:
    """Fit and score every split of an arm."""
    robot = Robot.load(data / arm.folder / "robot.urdf")
    logs = read_recordings([data / arm.folder], joints=robot.joints)
    motions = [motion_from_recording(x, cutoff=2 * arm.cutoff) for x in logs]
    standing = np.full(robot.size, arm.standing)
    for held_out, fitting, scoring in arm.splits(motions):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", HybridWarning)
            fit = identify(robot, [fitting], effects=arm.effects, cutoff=arm.cutoff)
        chain = published_chain(
            robot, [fitting], effects=arm.effects, cutoff=arm.cutoff
        )
        both = replace(fit.model, simpler=beside(chain, fit.model))
        validation = validate(both, [scoring], standing=standing)
        said = tuple(str(x.message) for x in caught)
        squares = held_out_squares(fit, scoring, standing)
        yield Score(arm, held_out, fit, validation, squares, said)


def main() -> None:
    """Measure all arms, print the tables, write the report."""
    parser = command_line(__doc__, "real_arms")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    args, console, scores = parser.parse_args(), Console(width=130), []
    text = ""
    warnings.simplefilter("ignore", HybridWarning)  # columns of the logs not needed
    for arm in ARMS:
        found = []
        for score in measure(arm, args.data):
            found.append(score)
            console.print(score.said(), highlight=False)
        table = arm_table(found)
        console.print(terminal_table(table))
        text += f"{captioned(table)}\n"
        text += "".join(f"- {x.said()}\n" for x in found) + "\n"
        scores += found
    command = "python experiments/real_arms.py DATA_FOLDER"
    save_figure(ratio_figure(scores), args.out / "figure.png")
    text = text.removesuffix("\n")
    write_tables(args.out, text, command, scores=[x.as_dict() for x in scores])


if __name__ == "__main__":
    main()
