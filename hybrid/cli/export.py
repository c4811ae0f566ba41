"""``hybrid export``: a model in a format that other programs run."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid.cli.options import add_common, check_outputs, record, write_record
from hybrid.errors import HybridError

if TYPE_CHECKING:
    from hybrid.cli.screen import Screen

_FORMATS = ("onnx", "torchscript", "c", "mjcf", "urdf", "json")

HELP = """export a model to C, ONNX, TorchScript, MJCF, URDF or JSON
c            one C99 header with an example and CMakeLists.txt; torque from q, v and a,
             limited to the rated one, with a status (see the header's own comments)
onnx         the same with a free batch axis, in double precision
torchscript  the same for libtorch; read it with torch.jit.load, never torch.load
mjcf         the simulator with identified links, rotors and friction
urdf         the same without what URDF has no place for
json         the model itself
Every folder holds a manifest.json: model hash, joint order, units, limits, training
range, version, and what the format cannot express. Several formats may share a folder.

--json: provenance, robot, joints, format, left_out.

example:
  hybrid export --model model.json --format c --out compensator"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.json")
    parser.add_argument("--format", required=True, choices=_FORMATS)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    add_common(parser)


def run(args: Namespace, screen: Screen) -> None:
    """Export and say what is missing."""
    from hybrid.export import export
    from hybrid.identify import DynamicModel

    if args.out.exists() and not args.out.is_dir():
        raise HybridError(f"{args.out}: is a file; valid is the name of a folder")
    model = DynamicModel.load(args.model)
    inputs = [args.model]
    check_outputs([args.out / "manifest.json", args.json], inputs)
    how = record(args, inputs)
    with screen.working("exporting"):
        left_out = export(model, args.out, format=args.format)
    robot = model.robot
    content = {"robot": robot.name, "joints": robot.joints, "format": args.format}
    write_record(args, how, {**content, "left_out": left_out})
    files = ", ".join(sorted(path.name for path in args.out.iterdir()))
    screen.say(f"{robot.name} as {args.format} in {args.out}: {files}")
    for text in left_out:
        screen.say(f"  not in it: {text}")
