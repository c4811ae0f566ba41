"""Replays of position servos: MuJoCo's C on one core and on all, MJX on a GPU.

Batches of stretches of 5 s, every replay with servos of its own. How far the positions
of MJX are from those of C comes first, for servos with each kind of law; then replays a
second, the best of three times after a first one that compiles.

    python benchmarks/replays.py --robot so101.xml --out reports/benchmarks
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results
from hybrid.robot import Robot
from hybrid.servo.accelerated import GpuRollout
from hybrid.servo.drive import Drive
from hybrid.servo.simulator import ServoSimulator, rolled
from hybrid.servo.stretch import Stretch

STEP, SAMPLES, STRETCHES, TIMES = 0.02, 251, 16, 3  # s, of a stretch


def stretch(robot: Robot, rng: np.random.Generator) -> Stretch:
    """Three tones and steps about the middle of every joint's range."""
    t, n = np.arange(SAMPLES)[:, None] * STEP, robot.size
    middle = (np.maximum(robot.q_min, -3) + np.minimum(robot.q_max, 3)) / 2
    goal = middle + rng.uniform(-0.2, 0.2, (6, n))[t[:, 0].astype(int)]
    for _ in range(3):
        rate, phase = rng.uniform(0.1, 1.0, n), rng.uniform(0, 6, n)
        goal = goal + rng.uniform(0.1, 0.5, n) * np.sin(2 * np.pi * rate * t + phase)
    return Stretch(STEP, goal, goal, np.zeros(n))


def kinds(robot: Robot) -> dict[str, Drive]:
    """Servos with each law in turn."""
    file = Drive.declared(robot)
    numbers = {"stiffness": 12.0, "damping": 0.8, "coulomb": 0.2, "armature": 0.02}
    usual = file.at(**numbers, offset=0.02, delay=0.013)
    changed = {
        "Coulomb friction, delay, offset": {},
        "dead band": {"dead_band": 0.02},
        "torque at its limit": {"stall": 0.4},
        "Stribeck friction": {"stiction": 0.15},
        "heavier links": {"mass": 1.4},
        "spring": {"spring": 2.0},
        "stops": {"lower": 0.3 * file["lower"], "upper": 0.3 * file["upper"]},
        "ground": {"ground": np.where(np.arange(robot.size) == 4, 0.1, file["ground"])},
        "other zero and sign": {"zero": 0.1, "sign": -1.0},
        "little friction, short presliding": {"coulomb": 0.01, "presliding": 3e-4},
    }
    return {name: usual.at(**x) for name, x in changed.items()}


def differences(robot: Robot, parts: list[Stretch]) -> dict[str, list[float]]:
    """RMS of MJX less C at every joint, for each kind of servo, [mrad]."""
    simulator, drives = ServoSimulator(robot), kinds(robot)
    exact = simulator.replay(parts, list(drives.values()))
    simulator.roll = GpuRollout(robot)
    other = simulator.replay(parts, list(drives.values()))
    off = (
        np.concatenate(x) - np.concatenate(y) for x, y in zip(exact, other, strict=True)
    )
    found = [1000 * np.sqrt(np.mean(x**2, axis=0)) for x in off]
    return dict(zip(drives, map(np.ndarray.tolist, found), strict=True))


def speeds(robot: Robot, parts: list[Stretch], batch: int, dead: float) -> dict:
    """Replays a second in a batch, and time of the first on the GPU, [s]."""
    rng, usual = np.random.default_rng(batch), next(iter(kinds(robot).values()))
    drives = [
        usual.at(stiffness=12 * np.exp(0.2 * rng.normal()), dead_band=dead)
        for _ in range(batch // len(parts))
    ]
    runs, cores = ServoSimulator(robot).runs(parts, drives), os.sched_getaffinity(0)
    out = {"batch": batch, "dead band [rad]": dead, "cores": len(cores)}
    gpu, start = GpuRollout(robot), time.perf_counter()
    gpu(runs)
    first, took = time.perf_counter() - start, best(gpu, runs)
    out["compiling [s]"] = round(first - took, 1)
    out["GPU [1/s]"] = batch / took
    out["C, all cores [1/s]"] = batch / best(rolled, runs)
    os.sched_setaffinity(0, {min(cores)})
    few = runs[:512]
    out["C, one core [1/s]"] = len(few) / best(rolled, few)
    os.sched_setaffinity(0, cores)
    return out


def best(roll, runs) -> float:
    """Least time of some runs, [s]."""
    times = []
    for _ in range(TIMES):
        start = time.perf_counter()
        roll(runs)
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Compare, measure, write."""
    import jax

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robot", type=Path, required=True)
    parser.add_argument("--batches", type=int, nargs="+", default=[64, 512, 4096])
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"))
    args = parser.parse_args()
    robot, rng = Robot.load(args.robot), np.random.default_rng(0)
    parts = [stretch(robot, rng) for _ in range(STRETCHES)]
    card, rows = jax.devices()[0].device_kind, []
    for batch, dead in [*((x, 0.0) for x in args.batches), (args.batches[1], 0.02)]:
        rows.append(speeds(robot, parts, batch, dead))
        print(rows[-1], flush=True)
    off = differences(robot, parts[:4])
    for name, x in off.items():
        print(f"{name:36} " + " ".join(f"{v:.1e}" for v in x), flush=True)
    cells = tuple(
        tuple(f"{v:g}" if v < 1 else f"{v:,.0f}" for v in x.values()) for x in rows
    )
    worst = max(max(x) for x in off.values())
    caption = f"{card}; positions differ by {worst:.1e} mrad RMS at most"
    table = markdown_table(Table(tuple(rows[0]), cells)) + f"\n{caption}.\n"
    print(table)
    how = provenance(command="python benchmarks/replays.py --robot so101.xml")
    content = {"card": card, "differences [mrad]": off, "speeds": rows}
    write_results(args.out / "replays.json", {"provenance": how, **content})
    with atomic_path(args.out / "replays.md") as path:
        path.write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()
