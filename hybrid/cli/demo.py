"""``hybrid demo``: a real log from reading to a model, without a robot or a network."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.examples import examples_folder
from hybrid.identification import identify
from hybrid.inspect import inspect_recording
from hybrid.recording import read
from hybrid.report import save_figure
from hybrid.report.fit import content_from_fit, excerpt_figure, held_out_table
from hybrid.report.inspection import clocks_table, verdict
from hybrid.robot import Robot

HELP = """\
A UR10 moved for twelve seconds, and ROS 2 recorded it. The demo reads the bag, holds it
against physics, identifies the arm, shows the torque error of every stage on samples
left out of the fit, and writes DIR/model.json and DIR/torque.png. It needs no network
and takes about ten seconds.

--json: as of 'hybrid identify'.

example:
  hybrid demo --out hybrid-demo"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--out", type=Path, default=Path("hybrid-demo"), metavar="DIR")


def run(args: Namespace, screen: Screen) -> None:
    """Read, inspect, identify, draw and show."""
    arm, bag = (examples_folder() / name for name in ("ur10.urdf", "ur10_bag"))
    model, picture = args.out / "model.json", args.out / "torque.png"
    args.inputs += [arm, bag]
    options.begin(args, model, picture)
    robot = Robot.load(arm)
    log = read(bag, joints=robot.joints)
    found = [inspect_recording(log, robot)]
    screen.show(clocks_table(found))
    screen.say(verdict(found))
    with screen.working(f"identifying {robot.name}"):
        fit = identify(robot, [log])
        figure = excerpt_figure(fit.model, log)
    fit.model.save(model)
    save_figure(figure, picture)
    options.write_record(args, content_from_fit(fit))
    screen.show(held_out_table(fit))
    screen.say(f"model: {model}")
    screen.say(f"measured and identified torque: {picture}")
    screen.say("next, with your own robot: hybrid inspect LOGS --robot ROBOT.urdf")
