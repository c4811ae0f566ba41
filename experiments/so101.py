"""An SO-101 without torque sensors: which numbers of its public simulator are wrong.

Three times another third of 36 real motions is kept aside; on it appear the errors of
open-loop replays by the public file, by a plain fit (stiffness, damping, friction,
rotor, offset and delay of every servo), and by the servos found, beside the resolution
of the encoder, and the processor time. `--cma` adds the same plain numbers sought by
CMA-ES for as many seconds of processor time, `--sysid` those of `mujoco.sysid`, both on
the stretches that ours has.

    python experiments/so101.py --data DIR --cma 600 --out reports/so101
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
from outputs import command_line
from servo_peers import by_peers

from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.recording import read_all
from hybrid.report import Table, markdown_table, provenance, save_figure, write_results
from hybrid.report.servo import findings_table, replay_figure
from hybrid.robot import Robot
from hybrid.servo.fit import fit_servo
from hybrid.servo.simulator import ServoSimulator, missed
from hybrid.servo.stretch import stretches_of

ARM = 5  # joints; the sixth is the gripper
THIRDS = 3


def error(robot, logs, drive) -> np.ndarray:
    """RMS error of replays, shape (n,), [mrad]."""
    return 1000 * missed(ServoSimulator(robot), stretches_of(logs), [drive])[0]


def main() -> None:
    """Fit, replay what was kept aside, and write."""
    parser = command_line(__doc__, "so101")
    parser.add_argument("--data", type=Path, required=True, help="logs and MJCF file")
    parser.add_argument("--cma", type=float, default=0.0, metavar="S")
    parser.add_argument("--sysid", action="store_true", help="needs mujoco[sysid]")
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    robot = Robot.load(args.data / "so101_new_calib.xml")
    logs = read_all(args.data / "*.parquet", joints=robot.joints, torque=False)
    rows, results = [], []
    for third in range(THIRDS):
        unseen = logs[third::THIRDS]
        learn, start = [x for x in logs if x not in unseen], time.process_time()
        fit = fit_servo(robot, learn)
        seconds = time.process_time() - start
        servos = {"public file": (robot, None, 0.0)}
        servos |= by_peers(robot, learn, args, third)
        servos["plain fit"] = robot, fit.plain_drive, np.nan
        servos["found"] = robot, fit.drive, seconds
        errors = {k: (error(x, unseen, y), cpu) for k, (x, y, cpu) in servos.items()}
        for name, (x, cpu) in errors.items():
            cells = (f"{v:.1f}" for v in (*x, x[:ARM].mean()))
            took = "" if np.isnan(cpu) else f"{cpu:.0f}"
            rows.append((f"{third + 1}: {name}", *cells, took))
        results.append({name: x.tolist() for name, (x, _) in errors.items()})
        results[-1] |= {"seconds": seconds, "fit": fit.as_dict()}
        print(*rows[-len(errors) :], sep="\n", flush=True)
    caption = f"RMS error of replays of unseen motion, mrad; mean of {ARM} arm joints"
    header = ("third kept aside", *robot.joints, "mean", "CPU s")
    table = Table(header, tuple(rows), caption)
    replay = fit.replayed(max(unseen, key=lambda x: x.duration))
    save_figure(replay_figure(replay, robot.joints), args.out / "replay.png")
    text = f"{markdown_table(table)}\nThird 3:\n\n{markdown_table(findings_table(fit))}"
    asked = f" --cma {args.cma:g}" * bool(args.cma) + " --sysid" * args.sysid
    how = provenance(command=f"python experiments/so101.py --data DIR{asked}")
    write_results(args.out / "results.json", {"thirds": results, "provenance": how})
    with atomic_path(args.out / "table.md") as path:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
