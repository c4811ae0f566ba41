"""Short and slow logs of three real arms: is identify ever worse than least squares?

Stretches of a few seconds, taken at random places of the logs of a UR10, a Stäubli TX40
and a KUKA KR300, are fitted as the verb does it: at their own rate and at 50 Hz, with
the measured speed and without it. A row appears for each kind: RMS torque error on the
other log, or on the rest of the same one, over that of the better of plain and weighted
least squares, and how many joints are worse, by more than one and two standard errors.

    python experiments/short_logs.py DATA_FOLDER --first 1 --draws 6
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from outputs import command_line, write_tables
from real_arms_data import ARMS, Arm, held_out_squares, ratios

from hybrid import Recording, Robot, identify, read_recordings
from hybrid.arrays import Array
from hybrid.errors import HybridWarning
from hybrid.identification.preparation import motions_from_logs
from hybrid.report import Table, markdown_table

SECONDS = {"UR10": (10.0, 20.0), "TX40": (3.0, 6.0), "KR300": (5.0, 9.9)}
SLOW = 50.0  # Hz
APART = 0.5  # s between what is fitted and what is held out
LEAST = 1.0  # s of a stretch that is held out
HEADER = ("log", "fitted, s", "draws", "mean", "worst mean", "worst joint", "joints",
          "worse", "by 1 σ", "by 2 σ")  # fmt: skip


def rows(log: Recording, use: Array | slice) -> Recording:
    """Some samples of a log."""
    return replace(log, t=log.t[use], **{k: x[use] for k, x in log.channels.items()})


def kinds(logs: list[Recording]) -> Iterator[tuple[str, list[Recording]]]:
    """The logs of an arm at both rates, with the measured speed and without."""
    for step in (1, round(logs[0].rate / SLOW)):
        some = [rows(x, slice(None, None, step)) for x in logs]
        name = f"{logs[0].rate / step:.0f} Hz"
        if logs[0].v is not None:
            yield f"{name} with speed", some
        yield name, [replace(x, v=None) for x in some]


def measure(arm: Arm, robot: Robot, logs: list[Recording], seconds: float, seed: int):
    """Squares of plain least squares and ours in each second, (2, B, n), [N²·m²]."""
    rng = np.random.default_rng([seed, int(seconds)])
    log, *others = [logs[k] for k in rng.permutation(len(logs))]
    t = log.t - log.t[0]
    start = rng.uniform(0.0, t[-1] - seconds)
    parts = [t < start - APART, t > start + seconds + APART]
    apart = [rows(log, x) for x in parts if x.sum() > LEAST * log.rate]
    stretch = rows(log, (t >= start) & (t <= start + seconds))
    fit = identify(robot, [stretch], effects=arm.effects)
    motions, _ = motions_from_logs(others or apart, fit.model.cutoff)
    found = [held_out_squares(fit, x, fit.model.standing) for x in motions]
    return np.concatenate(found, axis=1)


def cells(found: list[Array]) -> tuple[str, ...]:
    """Cells of the draws of one kind of log."""
    found = [x for x in found if x.any()]  # a log may be too short to hold any out
    plain, ours = np.sqrt([x.sum(axis=1) for x in found]).mean(axis=-1).T
    moves = [x[:, :, (x.sum(axis=1) > 0).all(axis=0)] for x in found]
    mean, (ratio, error) = ours / plain, np.hstack([ratios(x) for x in moves])
    shown = np.exp(np.log(mean).mean()), mean.max(), ratio.max()
    worse = [(ratio - 1 > k * error).sum() for k in range(3)]
    counts = (str(x) for x in (ratio.size, *worse))
    return (str(len(found)), *(f"{100 * (x - 1):+.1f} %" for x in shown), *counts)


def main() -> None:
    """Measure all arms, print and write the table."""
    parser = command_line(__doc__, "short_logs")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    parser.add_argument("--first", type=int, default=1, help="seed of the first draw")
    parser.add_argument("--draws", type=int, default=6, help="of each kind of log")
    args, table, every = parser.parse_args(), [], {}
    seeds = range(args.first, args.first + args.draws)
    warnings.simplefilter("ignore", HybridWarning)
    for arm in ARMS:
        robot = Robot.load(args.data / arm.folder / "robot.urdf")
        whole = read_recordings([args.data / arm.folder], joints=robot.joints)
        for kind, logs in kinds(whole):
            name = f"{arm.name}, {kind}"
            for length in SECONDS[arm.name]:
                found = [measure(arm, robot, logs, length, seed) for seed in seeds]
                table.append((name, f"{length:.0f}", *cells(found)))
                every[f"{name}, {length:.0f} s"] = found
                print(*table[-1], sep=" | ", flush=True)
    command = "python experiments/short_logs.py DATA_FOLDER"
    command += f" --first {args.first} --draws {args.draws}"
    text = markdown_table(Table(HEADER, tuple(table)))
    write_tables(args.out, text, command, squares=every)


if __name__ == "__main__":
    main()
