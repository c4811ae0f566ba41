"""``hybrid track``: parameters followed sample by sample along a recording."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid.cli.options import (
    add_common,
    check_outputs,
    positive,
    record,
    write_record,
)

if TYPE_CHECKING:
    from hybrid.cli.screen import Screen

HELP = """track the parameters of a model along a recording, sample by sample
as a controller would, in one pass: base parameters, gains of the effects, payloads
grasped and dropped. Effects that change signals cannot be tracked; the learned
remainder is left out. Writes the columns time (s), one of each parameter, and
error_JOINT (N·m), ten times a second; the suffix of --out, .csv, .parquet or .npz, says
how.

--json: provenance, robot, joints, samples, changes (t, mass, statistic), taken (ten
parameters of the last payload), parameters, noise, microseconds (median per sample).

example:
  hybrid track --model model.json --recording logs/trajectory_1.csv --out track.csv"""

_PER_SECOND = 10


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.json")
    parser.add_argument(
        "--recording",
        type=Path,
        required=True,
        metavar="FILE",
        help="a .csv, .parquet or .npz file",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument(
        "--prior",
        type=positive,
        default=0.05,
        metavar="SHARE",
        help="relative standard deviation of the model's parameters (default: 0.05)",
    )
    add_common(parser)


def run(args: Namespace, screen: Screen) -> None:
    """Track, write and show."""
    from time import perf_counter_ns

    import numpy as np

    from hybrid.identify import DynamicModel
    from hybrid.identify.online import OnlineIdentifier, Sample
    from hybrid.recording import check_recording, read
    from hybrid.report.columns import write_columns, writer_of

    writer_of(args.out)
    model = DynamicModel.load(args.model)
    joints = model.robot.joints
    recording = check_recording(read(args.recording, joints=joints), model.robot)
    inputs = [args.model, args.model.with_suffix(".safetensors"), args.recording]
    check_outputs([args.out, args.json], inputs)
    how = record(args, inputs)
    rate = (len(recording.t) - 1) / recording.duration
    tracker = OnlineIdentifier.from_model(model, rate=rate, prior=args.prior)
    every, rows, taken = max(1, round(rate / _PER_SECOND)), [], []
    with screen.working(f"tracking {len(recording.t):,} samples"):
        for k, t in enumerate(recording.t.tolist()):
            start = perf_counter_ns()
            tracker.update(Sample(t, recording.q[k], recording.tau[k]))
            taken.append(perf_counter_ns() - start)
            if k % every == 0:
                rows.append(np.concatenate([[t], tracker.theta, tracker.error]))
    parameters = tracker.parameters
    names = ["time", *(p.name for p in parameters), *(f"error_{j}" for j in joints)]
    write_columns(args.out, dict(zip(names, np.array(rows).T, strict=True)))
    content = {
        "robot": model.robot.name,
        "joints": joints,
        "samples": len(recording.t),
        "changes": [vars(change) for change in tracker.changes],
        "taken": tracker.taken if tracker.changes else None,
        "parameters": [p.as_dict() for p in parameters],
        "noise": tracker.noise,
        "microseconds": np.median(taken) / 1000,
    }
    write_record(args, how, content)
    for change in tracker.changes:
        word = "grasped" if change.mass > 0 else "dropped"
        screen.say(f"{change.t:.2f} s: payload {word}")
    if tracker.changes:
        screen.say(f"last change of the mass held: {tracker.taken[0]:+.3g} kg")
    screen.say(f"{len(parameters)} parameters, {len(rows):,} rows in {args.out}")
