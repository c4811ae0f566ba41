"""Arguments that several verbs share, and functions that load what they name."""

import hashlib
import math
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from hybrid.cli.shared.screen import Screen
from hybrid.effects import Effect, effects_from_text
from hybrid.errors import HybridError, warn
from hybrid.files import output_fault
from hybrid.model import DynamicModel
from hybrid.plant import Plant, load_truth
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording, read, read_all
from hybrid.recording.formats import kind_of
from hybrid.report import provenance, write_results
from hybrid.robot import Robot
from hybrid.robot.library import robot_file


def names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise ArgumentTypeError(f"{text!r} is not names between commas")
    return found


def positions(text: str) -> dict[str, float]:
    """Names with numbers between commas, as ``A=0.3,B=1``."""
    pairs = (part.partition("=") for part in names(text))
    found = {name.strip(): _number(value) for name, _, value in pairs}
    if not all(map(math.isfinite, found.values())):
        raise ArgumentTypeError(f"{text!r} is not names with numbers, as torso=0.3")
    return found


def positive(text: str) -> float:
    """A finite number above zero."""
    if not 0 < (value := _number(text)) < math.inf:
        raise ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def _number(text: str) -> float:
    """A number; NaN for a text that is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def count(text: str) -> int:
    """A whole number from 1."""
    if not (value := whole(text)):
        raise ArgumentTypeError(f"{text!r} is not a whole number from 1")
    return value


def whole(text: str) -> int:
    """A whole number from 0."""
    if not (text.isascii() and text.isdigit()):
        raise ArgumentTypeError(f"{text!r} is not a whole number from 0")
    return int(text)


_MOST_NUMBERS = 1e8  # 24 GB, as a simulation holds 240 bytes for each
# Provenance has what is stated to a verb, less what it reads, writes or runs on.
_NOT_SETTINGS = {
    "verb", "run", "parser", "inputs", "how", "robot", "recordings", "recording",
    "model", "baseline", "effects_from", "out", "json", "rerun", "seed", "poses",
    "page", "plan", "scheduler", "workers",
}  # fmt: skip
_LOGS = (
    "ROS 2 bags (folder, .mcap, .db3), ROS 1 .bag, LeRobot datasets, .csv(.gz), .tsv, "
    ".parquet, .npz, .h5, .mat"
)
_SHARED: dict[str, dict[str, Any]] = {
    "--robot": {
        "type": robot_file,
        "required": True,
        "metavar": "FILE",
        "help": "the arm: URDF, MJCF or xacro, or a name as ur5e of robot_descriptions "
        "or example-robot-data",
    },
    "--joints": {
        "type": names,
        "metavar": "A,B,C",
        "help": "joints of the arm (default: the longest chain in the file)",
    },
    "--hold": {
        "type": positions,
        "default": {},
        "metavar": "A=X,B=Y",
        "help": "positions of joints off the arm, in rad or m (default: the file's)",
    },
    "--recordings": {
        "nargs": "+",
        "required": True,
        "metavar": "PATH",
        "help": f"files, folders or globs of {_LOGS}",
    },
    "--recording": {"type": Path, "required": True, "metavar": "PATH", "help": _LOGS},
    "--map": {
        "metavar": "FILE.yaml",
        "help": "which column is which channel of which joint in which unit, or the "
        "name of a preset: ur_rtde, ur_driver, libfranka, libfranka_log, lerobot, "
        "joint_state, plotjuggler (default: what labels and formats say)",
    },
    "--cutoff": {
        "type": positive,
        "metavar": "HZ",
        "help": "cut-off of columns and torque (default: from the spectrum)",
    },
    "--model": {"type": Path, "required": True, "metavar": "MODEL.json"},
    "--out": {"type": Path, "required": True, "metavar": "DIR"},
    "--seed": {"type": whole, "default": 0, "metavar": "N"},
    "--effects-from": {
        "type": Path,
        "action": "append",
        "default": [],
        "metavar": "FILE.py",
        "help": "load effects of your own from a Python file; may be repeated",
    },
    "--json": {
        "type": Path,
        "metavar": "FILE",
        "help": "write the results, and how they came about, for other programs",
    },
}


def add_robot(parser: ArgumentParser, *, required: bool = True, more: str = "") -> None:
    """Add ``--robot``, ``--joints`` and ``--hold``."""
    words = f"{_SHARED['--robot']['help']}{more}"
    add(parser, "--robot", required=required, help=words)
    add(parser, "--joints", "--hold")


def add(parser: ArgumentParser, *names: str, **changes: Any) -> None:
    """Add arguments that several verbs share, with changes of what they state."""
    for name in names:
        parser.add_argument(name, **_SHARED[name] | changes)


def option(parser: Any, name: str, words: str | None = None, **more: Any) -> None:
    """Add an option of one verb; its name has a placeholder, as ``--rate HZ``."""
    flag, _, metavar = name.partition(" ")
    more |= {"metavar": metavar} if metavar else {}
    parser.add_argument(flag, help=words, **more)


def number(
    parser: ArgumentParser, name: str, words: str, default: float | None = None
) -> None:
    """Add an option that takes a number above zero."""
    if default is not None:
        words += f" (default {default:g})"
    option(parser, name, words, type=positive, default=default)


def check_size(**factors: float) -> None:
    """Refuse work on more numbers, the product of the factors, than memory holds."""
    size = math.prod(factors.values())
    if size > _MOST_NUMBERS:
        words = " x ".join(f"{name} {x:g}" for name, x in factors.items())
        raise HybridError(
            f"{words} are {size:.2g} numbers; valid are up to {_MOST_NUMBERS:.0e}"
        )


def read_logs(
    args: Namespace,
    screen: Screen,
    joints: tuple[str, ...] | None,
    *,
    torque: bool = True,
) -> list[Recording]:
    """Read the logs of ``--recordings`` or ``--recording``.

    ``joints`` are those of the robot, base to tip, if known; with ``torque`` a log
    without it is refused.
    """
    one = getattr(args, "recording", None)
    with screen.working("reading recordings") as tell:
        options: dict[str, Any] = {"joints": joints, "map": args.map, "torque": torque}
        found = (
            [read(one, **options, progress=tell)]
            if one
            else read_all(args.recordings, **options, progress=tell)
        )
    args.inputs += dict.fromkeys(Path(log.source) for log in found)
    if args.map and Path(args.map).is_file():
        args.inputs.append(Path(args.map))
    return found


def load_robot(args: Namespace) -> Robot:
    """The arm of ``--robot``, ``--joints`` and ``--hold``."""
    args.inputs.append(args.robot)
    return Robot.load(args.robot, joints=args.joints, held=args.hold)


def load_model(args: Namespace, path: Path) -> DynamicModel:
    """The model of ``--model`` or ``--baseline``."""
    args.inputs.append(path)
    return DynamicModel.load(path)


def load_plant(args: Namespace) -> Plant:
    """Load the arm to simulate from a robot file or a truth, and add ``--effects``."""
    if args.robot.suffix.lower() not in (".yaml", ".yml"):
        robot = load_robot(args)
        return Plant(robot, load_effects(args.effects, robot))
    if args.joints or args.hold:
        raise HybridError(
            "--joints and --hold go with a robot file; a truth names its own"
        )
    nominal, plant = load_truth(args.robot)
    args.inputs += dict.fromkeys([args.robot, Path(plant.robot.path)])
    effects = load_effects(args.effects, nominal)
    # servo=None: it is tuned to the arm with the new effects.
    return replace(plant, effects=(*plant.effects, *effects), servo=None)


def load_effects(text: str, robot: Robot, *, gains: bool = True) -> list[Effect]:
    """Effects of ``--effects``, at their usual size for the arm.

    Without ``gains``, values of shapes alone may be set.
    """
    return effects_from_text(text, robot.joints, joint_scales(robot), gains=gains)


def _check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Refuse outputs that cannot be written, before any work is done."""
    taken = {path.resolve(): "an input" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        if fault := output_fault(path):
            raise HybridError(f"{path}: {fault}")
        parent = path.resolve().parent
        while not parent.exists():
            parent = parent.parent
        try:
            TemporaryFile(dir=parent).close()
        except OSError as error:
            raise HybridError(
                f"{path}: cannot be written; {parent} is no folder "
                "in which files can be made"
            ) from error
        if path.resolve() in taken:
            raise HybridError(f"{path}: is {taken[path.resolve()]} as well")
        taken[path.resolve()] = "another output"


def begin(args: Namespace, *outputs: Path | None) -> None:
    """Check the outputs; let ``args.how`` be versions, command, settings and inputs.

    The inputs are the files that functions of this module loaded.

    Raises:
        HybridError: An output is a folder or a device, lies where nothing can be
            written, is named twice, or is an input.
    """
    _check_outputs([*outputs, args.json], args.inputs)
    given = vars(args)
    seed = {"seed": given["seed"]} if "seed" in given else {}
    files = [*args.effects_from, *args.inputs]
    args.how = provenance(
        command=args.verb,
        settings={k: x for k, x in given.items() if k not in _NOT_SETTINGS},
        **seed,
        inputs=[{"file": file.name, "sha256": sha256(file)} for file in files],
    )


def sha256(path: Path) -> str:
    """Hash of a file, or of all files in a folder."""
    if path.is_dir():
        whole = hashlib.sha256()
        for part in sorted(x for x in path.rglob("*") if x.is_file()):
            whole.update(f"{part.relative_to(path)} {sha256(part)}\n".encode())
        return whole.hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_record(args: Namespace, content: Mapping[str, Any]) -> None:
    """Write results with their provenance to ``--json``, if it was given."""
    if args.json:
        write_results(args.json, {**content, "provenance": args.how})


def warn_of_others(folder: Path, paths: Sequence[Path]) -> None:
    """Warn of logs and motions in a folder that are not of this run."""
    others = sorted(
        path.name
        for path in folder.iterdir()
        if kind_of(path) and path not in paths and path.name[0] != "."
    )
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        warn(f"{folder} also holds {others[0]}{more}, not of this run")
