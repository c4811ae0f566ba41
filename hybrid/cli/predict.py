"""``hybrid predict``: torque that a model gives along a recording."""

from argparse import ArgumentParser, Namespace

import numpy as np

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.identification import predict
from hybrid.inspect import check_recordings
from hybrid.recording.write import write_columns, writer_of

HELP = """\
writes the columns time (s) and tau_JOINT (N·m); the suffix of --out, .csv, .parquet or
.npz, says how. The recording needs time and positions only. One with an irregular clock
is resampled first.

--json: provenance, robot, joints, samples, rms (of measured less predicted torque, all
samples, unfiltered; null without measured torque).

example:
  hybrid predict --model model.json --recording logs/trajectory_1.csv --out tau.csv"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add(parser, "--model", "--recording", "--map")
    options.add(parser, "--out", metavar="FILE")


def run(args: Namespace, screen: Screen) -> None:
    """Predict and write."""
    writer_of(args.out)
    model = options.load_model(args, args.model)
    joints = model.robot.joints
    (recording,) = options.read_logs(args, screen, joints, torque=False)
    # On the clock that the prediction will have.
    pieces = check_recordings([recording], model.robot)
    options.begin(args, args.out)
    with screen.working("predicting"):
        tau = np.concatenate([predict(model, x) for x in pieces])
    t = np.concatenate([x.t for x in pieces])
    columns = {f"tau_{joint}": tau[:, j] for j, joint in enumerate(joints)}
    write_columns(args.out, {"time": t, **columns})
    rms = None
    if recording.has_torque:
        measured = np.concatenate([x.tau for x in pieces])
        rms = np.sqrt(np.mean((measured - tau) ** 2, axis=0))
    content = {"robot": model.robot.name, "joints": joints, "samples": len(tau)}
    options.write_record(args, {**content, "rms": rms})
    screen.say(f"{len(tau):,} samples of {len(joints)} joints in {args.out}")
