"""An SO-101 without torque sensors: which numbers of its public simulator are wrong.

Three times another third of 36 real motions is kept aside; on it appear the errors of
open-loop replays by the public file, by a plain fit (stiffness, damping, friction,
rotor, offset and delay of every servo), and by the servos found, beside the resolution
of the encoder, and the processor time. `--cma` adds the same plain numbers sought by
CMA-ES on ten stretches of 12 s, for as many seconds of processor time.

    python experiments/so101.py --data DIR --cma 600 --out reports/so101
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
from outputs import command_line

from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.recording import read_all
from hybrid.report import Table, markdown_table, provenance, save_figure, write_results
from hybrid.report.servo import findings_table, replay_figure
from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, PLAIN, Drive
from hybrid.servo.fit import fit_servo
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import chosen, stretches_of

ARM = 5  # joints; the sixth is the gripper
THIRDS = 3


def missed(robot, logs, drive) -> np.ndarray:
    """RMS error of replays, shape (n,), [mrad]."""
    stretches = stretches_of(logs)
    (moved,) = ServoSimulator(robot).replay(stretches, [drive])
    errors = [q - x.q for q, x in zip(moved, stretches, strict=True)]
    return 1000 * np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def sought(robot, logs, seconds: float, seed: int) -> Drive:
    """Plain numbers by CMA-ES: one delay, five others of every joint."""
    import cma

    parts = chosen(stretches_of(logs), 120.0, 12.0)
    simulator, start = ServoSimulator(robot), Drive.declared(robot)
    rows = [NAMES.index(name) for name in PLAIN if name != "delay"]
    center = start.coordinates
    unit = np.where(np.isfinite(start.spread), start.spread, 1.0)[rows]

    def drive(x: np.ndarray) -> Drive:
        y = center.copy()
        y[rows] = center[rows] + unit * x[1:].reshape(len(rows), -1)
        return start.moved(y).at(delay=abs(x[0]) * 0.05)

    search = cma.CMAEvolutionStrategy(
        np.zeros(1 + unit.size), 0.5, {"seed": seed, "verbose": -9}
    )
    ends = time.process_time() + seconds
    while time.process_time() < ends:
        tried = search.ask()
        replays = simulator.replay(parts, [drive(x) for x in tried])
        costs = [
            np.mean(
                [
                    np.nan_to_num((q - p.q) ** 2, nan=9.0).mean()
                    for q, p in zip(own, parts, strict=True)
                ]
            )
            for own in replays
        ]
        search.tell(tried, costs)
    return drive(search.result.xbest)


def main() -> None:
    """Fit, replay what was kept aside, and write."""
    parser = command_line(__doc__, "so101")
    parser.add_argument("--data", type=Path, required=True, help="logs and MJCF file")
    parser.add_argument("--cma", type=float, default=0.0, metavar="S")
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    robot = Robot.load(args.data / "so101_new_calib.xml")
    logs = read_all(args.data / "*.parquet", joints=robot.joints, torque=False)
    rows, results = [], []
    for third in range(THIRDS):
        unseen = logs[third::THIRDS]
        learn = [x for x in logs if x not in unseen]
        start = time.process_time()
        fit = fit_servo(robot, learn)
        seconds = time.process_time() - start
        errors = {"public file": (missed(robot, unseen, None), 0.0)}
        if args.cma:
            other = sought(robot, learn, args.cma, seed=third)
            errors["plain, CMA-ES"] = missed(robot, unseen, other), args.cma
        errors["plain fit"] = missed(robot, unseen, fit.plain_drive), np.nan
        errors["found"] = missed(robot, unseen, fit.drive), seconds
        for name, (x, cpu) in errors.items():
            cells = (f"{v:.1f}" for v in (*x, x[:ARM].mean()))
            rows.append(
                (f"{third + 1}: {name}", *cells, "" if np.isnan(cpu) else f"{cpu:.0f}")
            )
        results.append({name: x.tolist() for name, (x, _) in errors.items()})
        results[-1] |= {"seconds": seconds, "fit": fit.as_dict()}
        print(*rows[-len(errors) :], sep="\n", flush=True)
    caption = f"RMS error of replays of unseen motion, mrad; mean of {ARM} arm joints"
    header = ("third kept aside", *robot.joints, "mean", "CPU s")
    table = Table(header, tuple(rows), caption)
    replay = fit.replayed(max(unseen, key=lambda x: x.duration))
    save_figure(replay_figure(replay, robot.joints), args.out / "replay.png")
    parts = [markdown_table(table), "Third 3:\n", markdown_table(findings_table(fit))]
    text = "\n".join(parts)
    how = provenance(
        command=f"python experiments/so101.py --data DIR --cma {args.cma:g}"
    )
    write_results(args.out / "results.json", {"thirds": results, "provenance": how})
    with atomic_path(args.out / "table.md") as path:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
