"""``hybrid simulate``: recordings of a simulated arm with a known truth."""

from argparse import ArgumentParser, Namespace

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.plant import simulate
from hybrid.plant.simulate import TRUTH, content_from_plant, recording_paths, write_run
from hybrid.recording.write import writer_of
from hybrid.shown import counted

HELP = """\
writes DIR/trajectory_1.csv ... and DIR/truth.json, which holds the effects with their
values. The same seed gives the same files.

examples:
  hybrid simulate --robot models/scara.xml --effects stribeck:elbow,torque_ripple \\
      --trajectories 4 --duration 10 --seed 0 --out logs
  hybrid simulate --robot models/coman_truth.yaml --out logs
  hybrid simulate --robot models/planar.xml --effects 'payload(mass=2),coulomb:1' \\
      --out logs"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(parser, more=", or a truth in YAML")
    words = "effect[:joint[+joint]][(name=value;...)] between commas, at their usual "
    words += "size; see 'hybrid effects' (default: none beside those of a truth)"
    options.option(parser, "--effects LIST", words, default="")
    options.option(parser, "--trajectories N", type=options.count, default=4)
    options.number(parser, "--duration S", "length of each trajectory, s", 10.0)
    options.add(parser, "--out", "--seed")
    parser.add_argument("--format", choices=("csv", "parquet", "npz"), default="csv")


def run(args: Namespace, screen: Screen) -> None:
    """Simulate and write."""
    suffix = f".{args.format}"
    writer_of(args.out / f"log{suffix}")  # refuses what cannot be written
    plant = options.load_plant(args)
    options.check_size(
        trajectories=args.trajectories,
        duration=args.duration,
        rate=plant.control_rate,
        joints=plant.robot.size,
    )
    paths = recording_paths(args.out, args.trajectories, suffix)
    options.begin(args, *paths, args.out / TRUTH)
    with screen.working(f"simulating {plant.robot.name}"):
        recordings = simulate(
            plant,
            trajectories=args.trajectories,
            duration=args.duration,
            seed=args.seed,
        )
    truth = content_from_plant(plant)
    write_run(args.out, recordings, truth | {"provenance": args.how}, suffix=suffix)
    files = [{"file": path.name, "sha256": options.sha256(path)} for path in paths]
    options.write_record(args, truth | {"recordings": files})
    screen.say(
        f"{plant.robot.name}: {counted(len(paths), 'motion')} of {args.duration:g} s "
        f"with {counted(len(plant.effects), 'effect')} in {args.out}"
    )
    options.warn_of_others(args.out, paths)
