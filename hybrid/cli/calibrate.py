"""``hybrid calibrate``: the geometry of an arm from measured poses."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration import (
    Measurements,
    calibrate,
    choose_poses,
    cross_validate,
    nominal_errors,
    random_poses,
    read_measurements,
)
from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import CalibrationError, warn
from hybrid.recording.write import write_columns
from hybrid.report import write_results
from hybrid.report.calibration import (
    content_from_calibration,
    corrections_table,
    errors_table,
)
from hybrid.robot import Robot

HELP = """\
writes DIR/calibration.json and DIR/NAME, the robot's own file with its joints where
they are. Columns of poses.csv: q1 ... or q_<joint>, and what was measured at rest:
x, y, z of a point on the flange (x_2, y_2, z_2 of a second one), with qx, qy, qz, qw or
rx, ry, rz or roll, pitch, yaw of the tool; or distance (distance_2) from a station that
stands anywhere. Units in brackets: [mm], [deg]; m and rad without. An empty cell was
not seen.

--choose N writes DIR/poses.csv instead: the N poses most worth measuring. They keep to
the joint limits; collisions are not looked at.

calibration.json: robot, joints, measured, poses, errors (on poses left out),
parameters, unidentifiable, rejected, noise, observability, iterations, evaluations,
converged, base, tools, stations, chain, provenance.

examples:
  hybrid calibrate --robot arm.urdf --choose 40 --out plan
  hybrid calibrate --robot arm.urdf --poses poses.csv --out calibrated
  hybrid calibrate --robot arm.urdf --poses poses.csv --out calibrated \\
      --free base,tool,geometry,compliance"""

_CANDIDATES = 1000  # random poses to choose from
_FAR = 0.05  # m: a larger error means wrong units or columns
_WHOLLY = 0.5  # of what measurements vary by: a larger error, and no file explains them


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(parser)
    task = parser.add_mutually_exclusive_group(required=True)
    options.option(task, "--poses FILE.csv", "what was measured", type=Path)
    words = "poses to measure, instead"
    options.option(task, "--choose N", words, type=options.count)
    options.add(parser, "--out", "--seed")
    free = "base", "tool", "geometry"
    words = "what is unknown, of base, tool, geometry (default: these), compliance "
    words += "(of the joints under gravity) and scale (of a distance meter)"
    options.option(parser, "--free LIST", words, type=options.names, default=free)
    words = "with --choose: what will be measured (default: position)"
    kinds = "position", "pose"
    options.option(parser, "--measure", words, choices=kinds, default=kinds[0])
    words = "plain least squares over all measurements"
    options.option(parser, "--keep-outliers", words, action="store_true")


def run(args: Namespace, screen: Screen) -> None:
    """Calibrate, or choose poses, write and show."""
    robot = options.load_robot(args)
    if args.choose:
        _choose(args, robot, screen)
    else:
        _calibrate(args, robot, screen)


def _choose(args: Namespace, robot: Robot, screen: Screen) -> None:
    path = args.out / "poses.csv"
    options.begin(args, path)
    candidates = random_poses(robot, _CANDIDATES, args.seed)
    with screen.working(f"choosing poses of {robot.name}"):
        rows = choose_poses(
            robot, candidates, args.choose, kind=args.measure, free=args.free
        )
    chosen = np.round(candidates[rows], 6)  # µrad or µm
    names = [f"q_{joint}" for joint in robot.joints]
    write_columns(path, dict(zip(names, chosen.T, strict=True)))
    options.write_record(args, {"robot": robot.name, "poses": chosen})
    screen.say(f"{len(rows)} of {_CANDIDATES} random poses: {path}")


def _calibrate(args: Namespace, robot: Robot, screen: Screen) -> None:
    written, summary = args.out / args.robot.name, args.out / "calibration.json"
    data = read_measurements(args.poses, robot.joints)
    args.inputs.append(args.poses)
    options.begin(args, written, summary)
    robust = not args.keep_outliers
    with screen.working(f"calibrating {robot.name} from {data.size} poses"):
        # Before the long fit, which wrong columns make minutes long.
        _check_columns(data, nominal_errors(robot, data, free=args.free, robust=robust))
        calibration = calibrate(robot, data, free=args.free, robust=robust)
        errors = cross_validate(robot, data, free=args.free, robust=robust)
    content = content_from_calibration(calibration, errors)
    calibration.save(written)
    write_results(summary, content | {"provenance": args.how})
    options.write_record(args, content)
    screen.show(errors_table(errors), corrections_table(calibration))
    for text in calibration.unidentifiable:
        screen.say(f"unidentifiable: {text}")
    for x in calibration.solution.rejected:
        unit = "rad" if x.kind == "orientation" else "m"
        screen.say(f"left out: {x.kind} of pose {x.pose + 1}, {x.size:.2g} {unit} off")
    screen.say(f"robot: {written}, with {summary.name}")


def _check_columns(data: Measurements, errors: Mapping[str, Array]) -> None:
    """Warn of wrong units or columns, and refuse what the nominal arm misses wholly."""
    for kind in ("position", "distance"):
        if kind not in errors:
            continue
        size = float(np.sqrt(np.mean(errors[kind] ** 2)))
        if size <= _FAR:
            continue
        points = np.ma.masked_invalid(getattr(data, kind))  # or distances; some unseen
        squares = points.var(axis=0).reshape(points.shape[1], -1).sum(axis=1)
        spread = float(np.sqrt(squares.mean()))
        fault = (
            f"the nominal arm misses the measurements by {1e3 * size:.0f} mm, and they "
            f"vary by {1e3 * spread:.0f} mm; check units and order of the columns"
        )
        if size > _WHOLLY * spread:
            raise CalibrationError(f"{data.source}: {fault}")
        warn(fault)
