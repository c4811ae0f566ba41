"""``hybrid track``: parameters followed sample by sample along a recording."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen

HELP = """track the parameters of a model along a recording, sample by sample
as a controller would, in one pass: base parameters, gains of the effects, payloads
grasped and dropped. Effects that change signals cannot be tracked; the learned
remainder is left out. Writes the columns time (s), one of each parameter, and
error_JOINT (N·m), ten times a second; the suffix of --out, .csv, .parquet or .npz, says
how.

Samples that cannot be used are left out and counted, as in a controller.

--json: provenance, robot, joints, samples, health (what became of the samples), changes
(t, statistic, and mass, known a second later), parameters, noise, microseconds (median
per sample).

example:
  hybrid track --model model.json --recording logs/trajectory_1.csv --out track.csv"""

_PER_SECOND = 10
_WEIGHED = 1.0  # s after which the mass of a payload is read


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.json")
    options.add_recording(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument(
        "--prior",
        type=options.positive,
        default=0.05,
        metavar="SHARE",
        help="relative standard deviation of the model's parameters (default: 0.05)",
    )
    options.add_common(parser)


def run(args: Namespace, screen: Screen) -> None:
    """Track, write and show."""
    from time import perf_counter_ns

    import numpy as np

    from hybrid.inspect import inspect_recording
    from hybrid.inspect.doubt import raise_or_warn
    from hybrid.online import OnlineIdentifier, Sample
    from hybrid.recording.write import write_columns, writer_of

    writer_of(args.out)
    model = options.load_model(args, args.model)
    joints = model.robot.joints
    (recording,) = options.read_logs(args, screen, joints)
    recording = recording.in_order(joints)
    # The tracker leaves wrong rows out, and says so; a wrong column it believes.
    doubts = inspect_recording(recording, model.robot).doubts
    raise_or_warn(doubts, recording.source, rows=False)
    times, q, tau = recording.t, recording.q, recording.tau
    how = options.begin(args, [args.out])
    rate, prior = recording.rate, args.prior
    tracker = OnlineIdentifier.from_model(model, rate=rate, prior=prior)
    every, rows, taken = max(1, round(rate / _PER_SECOND)), [], []
    changes: list[dict[str, float]] = []
    with screen.working(f"tracking {len(times):,} samples"):
        for k, t in enumerate(times.tolist()):
            start = perf_counter_ns()
            change = tracker.update(Sample(t, q[k], tau[k]))
            taken.append(perf_counter_ns() - start)
            if change:
                changes.append(vars(change) | {"mass": tracker.taken[0]})
            elif changes and t < changes[-1]["t"] + _WEIGHED:
                changes[-1]["mass"] = tracker.taken[0]
            if k % every == 0:
                rows.append(np.concatenate([[t], tracker.theta, tracker.error]))
    parameters = tracker.parameters
    names = ["time", *(p.name for p in parameters), *(f"error_{j}" for j in joints)]
    write_columns(args.out, dict(zip(names, np.array(rows).T, strict=True)))
    content = {
        "robot": model.robot.name,
        "joints": joints,
        "samples": len(times),
        "health": vars(tracker.health),
        "changes": changes,
        "parameters": [p.as_dict() for p in parameters],
        "noise": tracker.noise,
        "microseconds": np.median(taken) / 1000,
    }
    options.write_record(args, how, content)
    for found in changes:
        word = "grasped" if found["mass"] > 0 else "dropped"
        screen.say(f"{found['t']:.2f} s: {abs(found['mass']):.3g} kg {word}")
    screen.say(f"{len(parameters)} parameters, {len(rows):,} rows in {args.out}")
    for text in (tracker.health.summary, *tracker.health.problems):
        screen.say(text)
