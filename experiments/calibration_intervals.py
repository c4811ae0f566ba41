"""Whether the intervals of a calibration hold, also where a pose's points share errors.

A table appears: for each kind of measurement and of error, the share of the geometry's
corrections within their 95 % intervals, as the product gives them and as independent
measurements would have them (±1.96 σ). Errors are independent (0.05 mm and mrad), or
common to a pose: joints off by 0.1 mrad, or the instrument by 0.1 mm. Encoders that run
out of true by 0.2 mrad are no noise: there the share is of pairs of logs that agree.

    python experiments/calibration_intervals.py --arm z1 --poses 40 --seeds 60
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from calibration_logs import ERRORS, KINDS, Log
from outputs import captioned, command_line, write_tables
from rich.console import Console

from hybrid.calibration import calibrate
from hybrid.calibration.calibrate import Calibration
from hybrid.report import terminal_table
from hybrid.report.table import Table
from hybrid.robot import Robot

FRAMES = ("base", "tool", "reflector", "station")
Found = dict[str, np.ndarray]  # value, half interval, 1.96 σ


def found(fit: Calibration) -> Found:
    """Corrections of the arm with both kinds of interval."""
    solution = fit.solution
    half = np.subtract(*solution.interval()[::-1]) / 2
    J = solution.jacobian
    alone = 1.96 * np.sqrt(np.diagonal(np.linalg.inv(J.T @ J)))
    rows = np.stack([solution.x, half, alone], axis=1)
    both = zip(solution.labels, rows, strict=True)
    return {label: x for label, x in both if not label.startswith(FRAMES)}


def inside(one: Found, other: Found) -> list[np.ndarray]:
    """Whether two estimates of each correction agree, by either interval."""
    both = [(one[x], other[x]) for x in one if x in other]
    return [abs(a[0] - b[0]) < np.hypot(a[1:], b[1:]) for a, b in both]


def share(robot: Robot, kind: str, error: str, poses: int, seeds: int) -> list[float]:
    """Shares within either interval, in per cent."""
    logs = [Log(robot, kind, error, poses, seed) for seed in range(seeds)]
    fits = [found(calibrate(robot, log.measured())) for log in logs]
    if error == "eccentric encoders":
        pairs = list(zip(fits[::2], fits[1::2], strict=False))
    else:
        exact = Log(robot, kind, "none", 200, seeds).measured()
        truth = found(calibrate(robot, exact, robust=False))
        pairs = [(fit, {k: x * [1, 0, 0] for k, x in truth.items()}) for fit in fits]
    hits = [hit for pair in pairs for hit in inside(*pair)]
    return [100 * float(x) for x in np.mean(hits, axis=0)]


def main() -> None:
    """Calibrate, count, print and write."""
    parser = command_line(__doc__, "calibration_intervals")
    parser.add_argument("--arm", default="z1", help="name of a robot")
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=60)
    args = parser.parse_args()
    robot = Robot.load(args.arm)
    # Poses of arms without limits, and of those with, are drawn alike.
    wide = np.minimum(np.abs(robot.q_max), 2.0)
    robot = replace(robot, q_min=-wide, q_max=wide)
    rows = [
        (kind, error, share(robot, kind, error, args.poses, args.seeds))
        for kind in KINDS
        for error in ERRORS
    ]
    lines = [(a, b, *(f"{x:.1f} %" for x in shares)) for a, b, shares in rows]
    header = ("measured", "errors", "within 95 % interval", "if independent")
    table = Table(header, tuple(lines), f"{robot.name}, {args.poses} poses")
    Console(width=100, highlight=False).print(terminal_table(table))
    command = f"python experiments/calibration_intervals.py --arm {args.arm} "
    command += f"--poses {args.poses} --seeds {args.seeds}"
    write_tables(args.out, captioned(table), command, rows=rows)


if __name__ == "__main__":
    main()
