"""``hybrid export``: a model in a format that other programs run."""

from argparse import ArgumentParser, Namespace
from dataclasses import replace

from hybrid.arrays import Array
from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError, warn
from hybrid.exports import FORMATS, export, read_manifest
from hybrid.exports.manifest import FILE as MANIFEST
from hybrid.exports.simulator.check import gaps
from hybrid.identification import DynamicModel
from hybrid.identification.preparation import checked_logs, motions_from_logs
from hybrid.identification.validation import warn_of_own_logs
from hybrid.model import check_same_arm
from hybrid.names import file_stem
from hybrid.robot import Robot
from hybrid.signals import Motion

HELP = """\
c            one C99 header with an example and CMakeLists.txt; torque from q, v and a,
             limited to the rated one, with a status (see the header's own comments)
onnx         the same with a free batch axis, in double precision, without the limit
torchscript  the same for libtorch; read it with torch.jit.load, never torch.load
mjcf         the arm's own file with identified links, rotors and friction, and a .diff;
             --robot is the file; without one, links, joints and motors
urdf         the same without what URDF has no place for
isaaclab     actuators for Isaac Lab
ranges       what the recordings leave open of each number: YAML with 95 % intervals and
             correlations, event terms for Isaac Lab, a function for MuJoCo Playground
json         the model itself
Every folder holds a manifest.json: model hash, joint order, units, limits, training
range, version, and what the format cannot express. Several formats may share a folder.

--recordings: friction that a robot file has no place for is fitted at the speeds of
these logs (mjcf, urdf, isaaclab); of logs that the model was not made from, RMS torque
that the file as it was, the file written (mjcf, urdf) and the model miss is shown.

--json: provenance, robot, joints, format, left_out, gap.

examples:
  hybrid export --model model.json --format c --out compensator
  hybrid export --model model.json --format mjcf --recordings held_out --out sim"""
_SCORED = ("mjcf", "urdf")
_FITTED = (*_SCORED, "isaaclab")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add(parser, "--model", "--out")
    parser.add_argument("--format", required=True, choices=FORMATS)
    words = "robot to write again, a file or a name (default: the model's file, if it "
    words += "is beside it)"
    options.add(parser, "--robot", required=False, help=words)
    options.add(parser, "--recordings", required=False)
    options.add(parser, "--map")


def run(args: Namespace, screen: Screen) -> None:
    """Export and say what is missing."""
    if args.out.exists() and not args.out.is_dir():
        raise HybridError(f"{args.out}: is a file; valid is the name of a folder")
    model = _with_file(options.load_model(args, args.model), args)
    motions = _motions(args, model, screen)
    options.begin(args, args.out / MANIFEST)
    with screen.working("exporting"):
        left_out = export(model, args.out, format=args.format, motions=motions)
    robot = model.robot
    content = {"robot": robot.name, "joints": robot.joints, "format": args.format}
    gap = _gap(args, model, motions)
    options.write_record(args, {**content, "left_out": left_out, "gap": gap})
    files = ", ".join(sorted([MANIFEST, *read_manifest(args.out)["files"]]))
    screen.say(f"{robot.name} as {args.format} in {args.out}: {files}")
    for text in left_out:
        screen.say(f"  not in it: {text}")
    for name, missed in gap.items():
        numbers = ", ".join(f"{x:.3g}" for x in missed)
        unit = robot.chain.unit_at(range(robot.size), "N·m")
        screen.say(f"  torque missed, {name}: {numbers} {unit} RMS")


def _motions(args: Namespace, model: DynamicModel, screen: Screen) -> list[Motion]:
    """Motions of ``--recordings``, if there are any."""
    if not args.recordings:
        return []
    if args.format not in _FITTED:
        raise HybridError(
            f"--recordings: nothing of {args.format} is fitted to speeds; valid are "
            f"formats {', '.join(_FITTED)}"
        )
    read = options.read_logs(args, screen, model.robot.joints)
    logs = checked_logs(model.robot, read)
    if args.format in _SCORED:
        warn_of_own_logs(model, logs)
    return motions_from_logs(logs, model.cutoff)[0]


def _gap(
    args: Namespace, model: DynamicModel, motions: list[Motion]
) -> dict[str, Array]:
    """What simulators and model miss of recordings."""
    if not motions or args.format not in _SCORED:
        return {}
    suffix = "xml" if args.format == "mjcf" else "urdf"
    stem = file_stem(model.robot.name)
    return gaps(model, args.out / f"{stem}.{suffix}", motions)


def _with_file(model: DynamicModel, args: Namespace) -> DynamicModel:
    """The model with its robot's file, as given or beside the model."""
    if args.robot and not args.robot.is_file():
        raise HybridError(f"{args.robot}: no such robot file")
    own, beside = model.robot, args.model.parent / model.robot.path
    path = args.robot or (beside if own.path and beside.is_file() else "")
    if args.robot or (path and args.format in _SCORED):
        args.inputs.append(path)
        try:
            robot = Robot.load(path, joints=own.joints, held=dict(own.held))
            check_same_arm(model, robot)
        except HybridError as error:
            if args.robot:
                raise
            raise HybridError(
                f"{error}; it was found beside {args.model}, --robot FILE names another"
            ) from error
    if not path and args.format in _SCORED:
        warn(
            f"{model.robot.path or 'the robot file'}: not beside {args.model}; only "
            "links, joints and motors are written; --robot FILE keeps all else of it"
        )
    return replace(model, robot=replace(model.robot, path=str(path)))
