"""Exported and read again: what a simulator's file misses that the model does not.

A table appears for the arms of the tests, the demo and three real arms: RMS torque
error on moving samples that no fit has seen, of the identified model, of the MJCF and
the URDF file that are written of it, as MuJoCo and our reader compute torque, and of
the MJCF file with the callback; and by how much file and callback, and file and
exported C, differ from the model. With --diagnose a second table says what a diagnosis
finds that the MJCF file lacks, and that the model itself lacks, on the same unseen
motion; it takes some minutes.

    python experiments/round_trip.py --data DATA_FOLDER
    python experiments/round_trip.py --data DATA_FOLDER --diagnose
"""

from __future__ import annotations

import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from compiled_model import CompiledModel
from outputs import captioned, command_line, write_tables
from rich.console import Console
from round_trip_cases import Case, cases, moving, with_callback

from hybrid import Robot
from hybrid.errors import HybridWarning
from hybrid.exports import missing_model, model_simulator
from hybrid.exports.simulator.check import file_torque, gaps
from hybrid.report import terminal_table
from hybrid.report.table import Table

TABLE = (
    ("arm", "joint", "model [N·m]", "MJCF ÷ model", "URDF ÷ model",
     "MJCF + callback ÷ model", "+ callback [N·m]", "+ C [N·m]"),
    "Held-out torque error, exported and read again", "table",
)  # fmt: skip
DIAGNOSED = (
    ("arm", "MJCF ÷ model, worst joint", "MJCF lacks", "the model itself lacks"),
    "What a diagnosis finds on unseen motion that file and model lack", "diagnosed",
)  # fmt: skip


def diagnosed(case: Case) -> tuple[str, ...]:
    """Row of an arm: what its exported file lacks, and what the model does."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "arm.xml")
        model_simulator(case.model, motions=case.fitting, folder=folder).write(file)
        found = gaps(case.model, file, case.scoring)
        worst = (found["exported"] / found["model"]).max()
        arm = Robot.load(file, joints=case.model.robot.joints)
    lacks = (case.findings(x) for x in (arm, case.model))
    return case.name, f"{worst:.3f}", *lacks


def round_trip(case: Case) -> list[tuple[str, ...]]:
    """A row for each joint of an arm."""
    model, joints, ratio = case.model, case.model.robot.joints, []
    with TemporaryDirectory() as folder:
        for kind, suffix in (("urdf", "urdf"), ("mjcf", "xml")):
            file = Path(folder, f"arm.{suffix}")
            made = model_simulator(
                model, kind=kind, motions=case.fitting, folder=folder
            )
            made.write(file)
            found = gaps(model, file, case.scoring)
            ratio.append(found["exported"] / found["model"])
        called, coded = with_callback(file, case), _with_code(file, case, made)
    return [
        (case.name, joint, f"{found['model'][j]:.3g}", f"{ratio[1][j]:.3f}",
         f"{ratio[0][j]:.3f}", f"{called[1, j]:.3f}",
         f"{called[0, j]:.1e}", f"{coded[j]:.1e}")
        for j, joint in enumerate(joints)
    ]  # fmt: skip


def _with_code(file: Path, case: Case, made) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Largest torque by which file and exported C differ from the model, [N·m]."""
    motion, model = case.scoring[0], case.model
    code = CompiledModel(missing_model(model, made), step=float(np.diff(motion.t)[0]))
    both = file_torque(file, model, motion)
    both += code.predict(motion.q, motion.v, motion.a)
    off = np.where(moving(model, motion), np.abs(both - model.predict(motion)), 0.0)
    return np.asarray(off.max(axis=0))


def main() -> None:
    """Export all arms, print the table, write the report."""
    parser = command_line(__doc__, "round_trip")
    parser.add_argument("--data", type=Path, help="folder with a folder for each arm")
    parser.add_argument("--diagnose", action="store_true", help="what is still missing")
    args, rows = parser.parse_args(), []
    warnings.simplefilter("ignore", HybridWarning)  # columns of the logs not needed
    for case in cases(args.data):
        rows += [diagnosed(case)] if args.diagnose else round_trip(case)
        print(*rows[-1], flush=True)
    header, caption, stem = DIAGNOSED if args.diagnose else TABLE
    table = Table(header, tuple(rows), caption)
    Console(width=130).print(terminal_table(table))
    command = "python experiments/round_trip.py --data DATA_FOLDER"
    command += " --diagnose" * args.diagnose
    write_tables(args.out, captioned(table), command, stem=stem, rows=rows)


if __name__ == "__main__":
    main()
