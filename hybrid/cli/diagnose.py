"""``hybrid diagnose``: what a simulator lacks, from logs of the real arm."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hybrid.cli.shared import options, servos
from hybrid.cli.shared.screen import Screen
from hybrid.diagnosis import diagnose
from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer import fixed
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.words import verdict_lines
from hybrid.errors import EffectError, HybridError, warn
from hybrid.files import atomic_folder, write_json
from hybrid.model import DynamicModel
from hybrid.recording import Recording
from hybrid.report.diagnosis import CONTENT, PAGE, write_diagnosis
from hybrid.report.servo import write_servo_page
from hybrid.report.viewers import Scene, scene_of_diagnosis, scene_of_servos, writer_of
from hybrid.robot import Robot

_MOST_NOTES = 3

HELP = """\
reads logs of the real arm (time, position, torque; temperature where it is there; one
with holes counts as several) and its simulator as it stands. Writes DIR/report.html, a
page that opens offline, and DIR/diagnosis.json with the same content for programs;
DIR/sim_fixed.xml, a MuJoCo file of the arm with what was found; DIR/model.json, which
also has what MJCF cannot express; and DIR/advice_1.csv ... (time, position, speed,
acceleration), motions to run next, where some are advised.

verdicts: no_gap, explained, partly_explained, unexplained (no known effect is the
cause), not_excited (the recordings move the arm too little).

--json: what is in diagnosis.json.

examples:
  hybrid simulate --robot models/coman_like.xml --effects stribeck:elbow --out logs
  hybrid diagnose --robot models/coman_like.xml --recordings logs --out diagnosis
  hybrid diagnose --robot arm.xml --recordings logs --out diagnosis --rerun gap.rrd
  hybrid diagnose --baseline model.json --recordings new_logs --out changed
  hybrid diagnose --baseline model.json --recordings with_3_kg --out scale \\
    --known-mass wrist_3=3"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(parser, required=False, more=", the simulator as it stands today")
    words = "a model of the healthy arm, as identify writes it, in place of --robot: "
    words += "what has changed since?"
    options.option(parser, "--baseline MODEL.json", words, type=Path)
    options.add(parser, "--recordings", "--map", "--out", "--cutoff", "--seed")
    servos.add_arguments(
        parser,
        known_mass="masses that were weighed, which set the scale of torque: of the "
        "link that a joint moves, the file's other links being off by the same factor; "
        "with --baseline, of what was mounted on that link since",
    )
    words = "write the arm, its replays and the gap over time to scrub through, .rrd "
    words += "for Rerun or .mcap for Foxglove; may be repeated"
    repeated = {"action": "append", "default": [], "type": Path}
    options.option(parser, "--rerun FILE", words, **repeated)


def run(args: Namespace, screen: Screen) -> None:
    """Diagnose, write the report and say what came out."""
    for path in args.rerun:
        writer_of(path)  # refuses what cannot be written
    simulator = _simulator(args)
    robot = simulator if isinstance(simulator, Robot) else simulator.robot
    recordings = options.read_logs(args, screen, robot.joints, torque=False)
    outputs = [
        args.out / name for name in (PAGE, CONTENT, fixed.SIMULATOR, fixed.MODEL)
    ]
    options.begin(args, *outputs, *args.rerun)
    if not servos.check_arguments(args, recordings, weighed=True):
        _diagnose_torque(args, robot, simulator, recordings, screen)
    elif args.baseline:
        raise HybridError("--baseline needs logs with torque; these have none")
    else:
        _diagnose_servos(args, robot, recordings, screen)


def _diagnose_torque(
    args: Namespace,
    robot: Robot,
    simulator: Robot | DynamicModel,
    recordings: Sequence[Recording],
    screen: Screen,
) -> None:
    with screen.working(f"diagnosing {robot.name}") as tell:
        result = diagnose.examine(
            simulator,
            recordings,
            cutoff=args.cutoff,
            known_mass=args.known_mass,
            seed=args.seed,
            progress=tell,
        )
        rng = np.random.default_rng(args.seed)
        result = with_motion_gap(result, rng, progress=tell)
        tell("writing the report", 0.85)
        with atomic_folder(args.out) as folder:
            advice = advise(result, rng, directory=folder)
            diagnosis = replace(result.diagnosis, advice=advice, provenance=args.how)
            notes = _fix(result, folder, args.out)
            found = notes is not None and bool(
                result.effects or result.command or args.known_mass
            )
            write_diagnosis(
                replace(result, diagnosis=diagnosis),
                folder,
                fixed=fixed.SIMULATOR if found else "",
            )
    options.write_record(args, diagnosis.as_dict())
    for line in verdict_lines(diagnosis):
        screen.say(line)
    screen.say(f"Report: {args.out / PAGE}")
    if found:
        screen.say(f"Simulator with what was found: {args.out / fixed.SIMULATOR}")
        if notes:
            screen.say(f"Exact in {args.out / fixed.MODEL} only: {_few(notes)}")
    _to_viewers(args, screen, lambda: scene_of_diagnosis(result))


def _to_viewers(args: Namespace, screen: Screen, scene: Callable[[], Scene]) -> None:
    """Write the files of ``--rerun``, or warn that the arm cannot be simulated."""
    if not args.rerun:
        return
    try:
        with screen.working("replaying all recordings"):
            shown = scene()
    except EffectError as error:
        warn(f"nothing to scrub through: {error}")
        return
    for path in args.rerun:
        writer_of(path)(shown, path)
        screen.say(f"Recording to scrub through: {path}")


def _simulator(args: Namespace) -> Robot | DynamicModel:
    """Load the simulator or the model to compare with."""
    if (args.robot is None) == (args.baseline is None):
        raise HybridError("either --robot or --baseline says what to compare with")
    if args.baseline is None:
        return options.load_robot(args)
    if args.joints or args.hold:
        raise HybridError("--joints and --hold go with --robot; a model has its own")
    return options.load_model(args, args.baseline)


def _diagnose_servos(
    args: Namespace, robot: Robot, recordings: Sequence[Recording], screen: Screen
) -> None:
    found = servos.fit(args, robot, recordings, screen)
    replay = found.replayed()
    with atomic_folder(args.out) as folder:
        write_json(folder / CONTENT, {**found.as_dict(), "provenance": args.how})
        write_servo_page(
            folder / PAGE, found, replay, fixed=fixed.SIMULATOR, provenance=args.how
        )
        found.save(folder / fixed.SIMULATOR)
    options.write_record(args, found.as_dict())
    servos.show(found, screen)
    screen.say(f"Report: {args.out / PAGE}")
    screen.say(f"Simulator with what was found: {args.out / fixed.SIMULATOR}")
    _to_viewers(args, screen, lambda: scene_of_servos(robot, replay))


def _few(notes: Sequence[str]) -> str:
    shown = "; ".join(notes[:_MOST_NOTES])
    more = len(notes) - _MOST_NOTES
    return f"{shown}; {more} more at the top of that file" if more > 0 else shown


def _fix(result: Result, folder: Path, home: Path) -> tuple[str, ...] | None:
    """Write the corrected simulator, or warn that it cannot be simulated."""
    try:
        return fixed.write_fixed(result, folder, home=home)
    except EffectError as error:
        warn(f"no corrected simulator: {error}")
        return None
