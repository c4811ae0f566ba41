"""Three real arms: what does the diagnosis say that their robot files lack?

For a UR10, a Stäubli TX40 and a KUKA KR300, whose files declare no friction, a table
appears with the effects found, each with its share, its joints and how far it shrinks
the torque gap on held-out samples; a second one and a picture have the gap of every
joint as the file stands, with its link parameters corrected alone, and of the simulator
that is written with all effects found. What is known of these arms from elsewhere
stands beside it in ``reports/real_arms/diagnosis.md``, which is written by hand.

    python experiments/real_arms_diagnosis.py DATA_FOLDER
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from outputs import command_line
from real_arms_data import ARMS, Arm
from real_arms_diagnosis_report import (
    Score,
    gap_figure,
    gap_table,
    held_out,
    in_words,
    said,
)
from rich.console import Console

from hybrid import Robot, read_recordings
from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.measure import split, unseen_samples
from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.report import provenance, save_figure, terminal_table, write_results

COMMAND = "python experiments/real_arms_diagnosis.py DATA_FOLDER"


def measure(arm: Arm, data: Path) -> Score:
    """Diagnose one arm from all of its logs."""
    robot = Robot.load(data / arm.folder / "robot.urdf")
    read = read_recordings([data / arm.folder], joints=robot.joints)
    logs = [replace(x, source=Path(x.source).name) for x in read]
    rng, start = np.random.default_rng(0), process_time()
    result = examine(robot, logs, cutoff=arm.cutoff)
    middle = process_time()
    result = with_motion_gap(result, rng)
    diagnosis = replace(result.diagnosis, advice=advise(result, rng))
    seconds = middle - start, process_time() - middle
    learnt, gap = split(result.gap), result.gap
    unseen = np.sum(unseen_samples(gap, learnt) & gap.sampled.mask) / gap.rate
    return Score(arm.name, diagnosis, held_out(result), float(unseen), seconds)


def main() -> None:
    """Diagnose all arms, print what is found, write the report."""
    parser = command_line(__doc__, "real_arms")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    args, console, text = parser.parse_args(), Console(width=120), ""
    warnings.simplefilter("ignore", HybridWarning)  # columns of the logs not needed
    content: dict[str, Any] = {"provenance": provenance(command=COMMAND), "arms": {}}
    for arm in ARMS:
        score = measure(arm, args.data)
        console.print(said(score), highlight=False, markup=False)
        console.print(terminal_table(gap_table(score)))
        text += in_words(score)
        content["arms"][arm.name] = score.as_dict()
        save_figure(gap_figure(score), args.out / f"diagnosis_{arm.name.lower()}.png")
    with atomic_path(args.out / "diagnosis_table.md") as path:
        path.write_text(f"{text}    {COMMAND}\n", encoding="utf-8")
    write_results(args.out / "diagnosis.json", content)


if __name__ == "__main__":
    main()
