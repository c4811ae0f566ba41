"""``hybrid track``: parameters followed sample by sample along a recording."""

from argparse import ArgumentParser, Namespace
from time import perf_counter_ns

import numpy as np

from hybrid.arrays import Array
from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.inspect import inspect_recording
from hybrid.inspect.doubt import raise_or_warn
from hybrid.online import OnlineIdentifier, Sample
from hybrid.recording import Recording
from hybrid.recording.write import write_columns, writer_of

HELP = """\
as a controller would, in one pass: base parameters, gains of the effects, payloads
grasped and dropped. Effects that change signals cannot be tracked; the learned
remainder is left out. Writes the columns time (s), one of each parameter, and
error_JOINT (N·m), ten times a second; the suffix of --out, .csv, .parquet or .npz, says
how.

Samples that jump or repeat the one before, and values that no arm has, are left out and
counted, as in a controller. A cell without a number, or a time twice, is refused.

--json: provenance, robot, joints, samples, health (what became of the samples), changes
(t, statistic, and mass, known a second later), parameters, noise, microseconds (median
per sample).

example:
  hybrid track --model model.json --recording logs/trajectory_1.csv --out track.csv"""

_PER_SECOND = 10
_WEIGHED = 1.0  # s after which the mass of a payload is read


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add(parser, "--model", "--recording", "--map")
    options.add(parser, "--out", metavar="FILE")
    words = "relative standard deviation of the model's parameters"
    options.number(parser, "--prior SHARE", words, 0.05)


def run(args: Namespace, screen: Screen) -> None:
    """Track, write and show."""
    writer_of(args.out)
    model = options.load_model(args, args.model)
    joints = model.robot.joints
    (recording,) = options.read_logs(args, screen, joints)
    recording = recording.in_order(joints)
    # The tracker leaves wrong rows out, and says so; a wrong column it believes.
    doubts = inspect_recording(recording, model.robot).doubts
    raise_or_warn(doubts, recording.source, rows=False)
    options.begin(args, args.out)
    tracker = OnlineIdentifier.from_model(model, rate=recording.rate, prior=args.prior)
    with screen.working(f"tracking {len(recording.t):,} samples"):
        rows, changes, taken = _tracked(tracker, recording)
    parameters = tracker.parameters
    names = ["time", *(p.name for p in parameters), *(f"error_{j}" for j in joints)]
    write_columns(args.out, dict(zip(names, np.array(rows).T, strict=True)))
    content = {
        "robot": model.robot.name,
        "joints": joints,
        "samples": len(recording.t),
        "health": vars(tracker.health),
        "changes": changes,
        "parameters": [p.as_dict() for p in parameters],
        "noise": tracker.noise,
        "microseconds": np.median(taken) / 1000,
    }
    options.write_record(args, content)
    for found in changes:
        word = "grasped" if found["mass"] > 0 else "dropped"
        screen.say(f"{found['t']:.2f} s: {abs(found['mass']):.3g} kg {word}")
    screen.say(f"{len(parameters)} parameters, {len(rows):,} rows in {args.out}")
    for text in (tracker.health.summary, *tracker.health.problems):
        screen.say(text)


def _tracked(
    tracker: OnlineIdentifier, recording: Recording
) -> tuple[list[Array], list[dict[str, float]], list[int]]:
    """Rows of time, parameters and errors; changes with masses; update times, [ns]."""
    every = max(1, round(recording.rate / _PER_SECOND))
    rows: list[Array] = []
    changes: list[dict[str, float]] = []
    taken = []
    samples = zip(recording.t.tolist(), recording.q, recording.tau, strict=True)
    for k, (t, q, tau) in enumerate(samples):
        start = perf_counter_ns()
        change = tracker.update(Sample(t, q, tau))
        taken.append(perf_counter_ns() - start)
        if change:
            changes.append(vars(change) | {"mass": tracker.taken[0]})
        elif changes and t < changes[-1]["t"] + _WEIGHED:
            changes[-1]["mass"] = tracker.taken[0]
        if k % every == 0:
            rows.append(np.concatenate([[t], tracker.theta, tracker.error]))
    return rows, changes, taken
