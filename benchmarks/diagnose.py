"""Speed and memory of a diagnosis: a minute of a seven-axis arm at 1 kHz.

A Panda of example-robot-data, whose file declares no friction, with Stribeck friction
on two joints and torque ripple on one, is logged for 60 s. The diagnosis in torque, its
replay in motion and the advice run in a fresh process, so that the peak memory is their
own; times are processor times. The costliest functions are those of a second, profiled
run.

    python benchmarks/diagnose.py
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL"):  # read when numpy loads
    os.environ[f"{_name}_NUM_THREADS"] = "1"

# ruff: noqa: E402
import argparse
import cProfile
import json
import pstats
import resource
import subprocess
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import files
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from hybrid import Robot, read_recordings, simulate
from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import Effect
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.plant.scale import joint_scales
from hybrid.recording import write
from hybrid.report import Table, markdown_table, provenance, write_results

REPORT = Path(__file__).parents[1] / "reports" / "benchmarks"
RATE, SECONDS = 1000.0, 60.0


def panda() -> Robot:
    """The arm, without its fingers."""
    name = "example-robot-data/robots/panda_description/urdf/panda.urdf"
    for file in files("example-robot-data") or ():
        if file.as_posix().endswith(name):
            return Robot.load(Path(str(file.locate())))
    raise FileNotFoundError(name)


def log(robot: Robot, folder: Path, parts: int) -> None:
    """Write a minute of motion, as one log or as several."""
    torque = [s.torque for s in joint_scales(robot)]
    lacking: list[Effect] = [
        Stribeck((j,), {"level": 0.04 * torque[j], "velocity": 0.08}) for j in (0, 3)
    ]
    sine = {"sine": 0.03 * torque[1], "cosine": 0.01 * torque[1], "periods": 20.0}
    lacking.append(TorqueRipple((1,), sine))
    recordings = simulate(
        robot,
        lacking,
        trajectories=parts,
        duration=SECONDS / parts,
        log_rate=RATE,
        seed=0,
    )
    for k, recording in enumerate(recordings):
        write(recording, folder / f"{k}.parquet")


def diagnosed(folder: Path, profiled: bool) -> dict[str, Any]:
    """Seconds and peak memory of this process; run it in a fresh one."""
    robot, rng = panda(), np.random.default_rng(0)
    recordings = read_recordings([folder], joints=robot.joints)
    found: dict[str, Any] = {"before": {"mebibytes": _peak()}}

    def measured(step: str, run: Callable[[], Any]) -> Any:
        profile, start = cProfile.Profile(process_time), process_time()
        value = profile.runcall(run) if profiled else run()
        found[step] = {"seconds": process_time() - start, "mebibytes": _peak()}
        found[step]["costs"] = _costs(profile) if profiled else []
        return value

    result = measured("examine", lambda: examine(robot, recordings))
    result = measured("replayed", lambda: with_motion_gap(result, rng))
    advice = measured("advise", lambda: advise(result, rng))
    found["named"] = [[f.effect, *f.joints] for f in result.diagnosis.findings]
    found["replay"] = ["motion" in f.shrink for f in result.diagnosis.findings]
    found["advice"] = len(advice)
    return found


def _costs(profile: cProfile.Profile) -> list[list[Any]]:
    """The functions that take longest by themselves, and ours with what they call."""
    stats: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    rows = []
    for (file, line, name), (_, calls, own, whole, _) in stats.items():
        place = f"{Path(file).stem}.{name}" if line else name
        rows.append([place, calls, own, whole, "hybrid" in file])
    alone = sorted(rows, key=lambda row: -row[2])[:10]
    ours = sorted((r for r in rows if r[4]), key=lambda row: -row[3])[:25]
    return [row[:4] for row in (*alone, *ours)]


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux: KiB


def _afresh(folder: Path, how: str) -> dict[str, Any]:
    command = [sys.executable, __file__, "--only", str(folder), how]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def table(runs: dict[str, dict[str, Any]]) -> Table:
    """Seconds of every step, and the peak memory after it."""
    rows = []
    for name, run in runs.items():
        steps = [run[step] for step in ("examine", "replayed", "advise")]
        cells = [f"{s['seconds']:.1f}" for s in steps]
        whole = sum(s["seconds"] for s in steps)
        peaks = [f"{s['mebibytes']:,.0f}" for s in (run["before"], *steps)]
        named = "; ".join(" ".join(x) for x in run["named"])
        rows.append((name, *cells, f"{whole:.1f}", *peaks, named))
    header = ("60 s × 7 joints at 1 kHz", "torque [s]", "replay [s]", "advice [s]",
              "all [s]", "MiB before", "after torque", "after replay", "after advice",
              "named")  # fmt: skip
    return Table(header, tuple(rows), "Processor time and peak memory of a diagnosis")


def main() -> None:
    """Measure, print, and write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--only", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)  # frozen fingers
    if options.only:
        folder, how = options.only
        print(json.dumps(diagnosed(Path(folder), how == "profiled")))
        return
    runs: dict[str, dict[str, Any]] = {}
    profiles: dict[str, dict[str, Any]] = {}
    for parts in (6, 1):
        with TemporaryDirectory() as scratch:
            log(panda(), Path(scratch), parts)
            name = f"{parts} log{'s' if parts > 1 else ''} of {SECONDS / parts:g} s"
            runs[name] = _afresh(Path(scratch), "timed")
            profiles[name] = _afresh(Path(scratch), "profiled")
    shown, command = table(runs), "python benchmarks/diagnose.py"
    text = f"{shown.caption}.\n\n{markdown_table(shown)}"
    print(text)
    content = {"provenance": provenance(command=command), "runs": runs}
    write_results(REPORT / "diagnose.json", content | {"profiled": profiles})
    with atomic_path(REPORT / "diagnose.md") as path:
        path.write_text(f"{text}\n    {command}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
