"""Speed and memory of the batched regressor, beside a Python loop over pinocchio's.

Both fill all columns (60 for six axes) of every sample on one core. Runs alternate, so
that a busy moment hits all; figures are medians with the lowest and highest. The loop
is timed as it is, and with the copy that it takes to keep its result.

    python benchmarks/regressor.py --json reports/benchmarks/regressor.json
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL"):  # read when numpy loads
    os.environ[f"{_name}_NUM_THREADS"] = "1"

# ruff: noqa: E402
import argparse
import platform
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, files, version
from pathlib import Path
from timeit import timeit
from typing import Any

import numpy as np
import pinocchio as pin

from hybrid.dynamics import regressor
from hybrid.files import write_json
from hybrid.robot import Robot

_SHIPPED = Path(__file__).parents[1] / "models" / "coman_like.xml"
_PUBLIC = "ur_description/urdf/ur10_robot.urdf"


def arms() -> Iterator[Robot]:
    """The shipped arm, and the UR10 where the example-robot-data wheel is installed."""
    yield Robot.load(_SHIPPED)
    with suppress(PackageNotFoundError):
        for file in files("example-robot-data") or ():
            if file.as_posix().endswith(_PUBLIC):
                yield Robot.load(str(file.locate()))


def contenders(robot: Robot, samples: int) -> dict[str, Callable[[], Any]]:
    """What is timed, by name."""
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-2.0, 2.0, (3, samples, robot.size))
    model = robot.pinocchio()
    data = model.createData()
    kept = np.empty((samples, robot.size, 10 * robot.size))

    def loop() -> None:
        for k in range(samples):
            pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k])

    def loop_with_copy() -> None:
        for k in range(samples):
            kept[k] = pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k])

    loop_with_copy()  # and its result is right
    ours = regressor(robot.chain, q, v, a)
    np.testing.assert_allclose(ours, kept, atol=1e-10 * np.abs(kept).max())
    batched = partial(regressor, robot.chain, q, v, a)
    return {"batched": batched, "loop": loop, "loop with copy": loop_with_copy}


def measure(robot: Robot, samples: int, repeats: int) -> dict[str, Any]:
    """Times [s], rates [1/s], memory [MB] and ratios of one arm."""
    runs = contenders(robot, samples)
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            times[name].append(timeit(run, number=1))
    middle = {name: float(np.median(x)) for name, x in times.items()}
    tracemalloc.start()
    runs["batched"]()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()  # it slows every allocation
    return {
        "task": f"{robot.name}: {samples} samples, {10 * robot.size} columns",
        "seconds": {n: [middle[n], min(x), max(x)] for n, x in times.items()},
        "samples_per_second": {n: samples / x for n, x in middle.items()},
        "times_as_long": {n: x / middle["batched"] for n, x in middle.items()},
        "peak_megabytes": peak / 1e6,
    }


def report(x: dict[str, Any]) -> None:
    """Print one arm's figures."""
    print(f"{x['task']}, one core")
    for name, (middle, low, high) in x["seconds"].items():
        rate, ratio = x["samples_per_second"][name], x["times_as_long"][name]
        figures = f"{middle:6.3f} s ({low:.3f}-{high:.3f}) {rate:9.0f} samples/s"
        print(f"  {name:15}{figures} {ratio:6.2f} x batched")
    print(f"  peak memory of batched {x['peak_megabytes']:.0f} MB, its result included")


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    content: dict[str, Any] = {name: version(name) for name in ("numpy", "pin")}
    content |= {"machine": f"{platform.machine()}, {os.cpu_count()} CPUs", "arms": []}
    for robot in arms():
        content["arms"].append(measure(robot, options.samples, options.repeats))
        report(content["arms"][-1])
    if options.json:
        write_json(options.json, content)


if __name__ == "__main__":
    main()
