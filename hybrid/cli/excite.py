"""``hybrid excite``: the motion that reveals the parameters."""

from argparse import ArgumentParser, Namespace

import numpy as np

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.excitation import (
    Clearance,
    Condition,
    Design,
    DOptimal,
    Floor,
    Fourier,
    Limits,
    Spline,
    design,
    observe,
)
from hybrid.excitation.constraints import Constraint
from hybrid.excitation.criteria import Criterion
from hybrid.excitation.design import DESIGN, reference_paths
from hybrid.excitation.observation import FITTED
from hybrid.plant.noise import Noise
from hybrid.report import save_figure
from hybrid.report.excitation import information_figure, motion_figure, postures_figure
from hybrid.robot import Robot
from hybrid.robot.geometry import capsules_from_robot
from hybrid.shown import counted

HELP = """\
writes DIR/reference_1.csv ... (time, position, speed, acceleration), DIR/design.json
(coefficients, condition, predicted standard errors) and the pictures motion.png,
information.png and postures.png. The motion starts and ends at rest and keeps the
limits between its samples too.

examples:
  hybrid excite --robot models/coman_like.xml --out excite
  hybrid excite --robot arm.urdf --criterion condition --out excite
  hybrid excite --robot arm.urdf --effects viscous,coulomb --clearance 0.02 \\
      --floor 0 --trajectories 3 --duration 20 --out excite"""

# The expected error is the default of a design.
_CRITERIA: dict[str, Criterion | None] = {
    "error": None, "condition": Condition(), "d": DOptimal(),
}  # fmt: skip
_PICTURES = ("motion.png", "information.png", "postures.png")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(parser)
    options.add(parser, "--out", "--seed")
    words = "effects to be identified beside the rigid body; laws of one joint "
    words += f"(default {FITTED}; for condition none)"
    options.option(parser, "--effects LIST", words)
    words = (
        "error: expected torque error on random motions within the limits (default); "
        "d: volume of the confidence ellipsoid; condition: number of the observation "
        "matrix, torque in N·m"
    )
    options.option(
        parser, "--criterion", words, choices=tuple(_CRITERIA), default="error"
    )
    _add_motion(parser)


def _add_motion(parser: ArgumentParser) -> None:
    parser.add_argument("--family", choices=("fourier", "spline"), default="fourier")
    options.option(parser, "--trajectories N", type=options.count, default=1)
    words = "choose the N motions as a set, not one after the other: better, slower"
    options.option(parser, "--together", words, action="store_true")
    options.option(parser, "--starts N", type=options.count, default=3)
    options.number(parser, "--duration S", "of each, s", 20.0)
    words = "harmonics (default 10)"
    options.option(parser, "--order N", words, type=options.count, default=10)
    options.number(parser, "--rate HZ", "of the CSV", 500.0)
    words = "part of position, speed, acceleration and torque limits to use"
    options.number(parser, "--fill PART", words, 0.8)
    options.number(parser, "--jerk J", "limit, rad/s³")
    options.number(parser, "--clearance M", "least distance of links, m")
    words = "height that links stay above, m"
    options.option(parser, "--floor Z", words, type=float)


def run(args: Namespace, screen: Screen) -> None:
    """Design and write."""
    robot = options.load_robot(args)
    plain = args.criterion == "condition"
    wanted = "" if plain and args.effects is None else args.effects or FITTED
    effects = options.load_effects(wanted, robot)
    counts = {"trajectories": args.trajectories, "duration": args.duration}
    counts["joints"] = robot.size
    grid = max(20.0, 8.0 * args.order / args.duration)
    options.check_size(**counts, rate=args.rate)
    options.check_size(**counts, rate=grid, coefficients=2 * args.order * robot.size)
    outputs = [*reference_paths(args.out, args.trajectories), args.out / DESIGN]
    pictures = [args.out / name for name in _PICTURES]
    options.begin(args, *outputs, *pictures)
    jerk = np.inf if args.jerk is None else args.jerk
    limits = Limits.of(robot, fill=args.fill, jerk=jerk)
    noise = None if plain else Noise.typical(robot).torque_covariance
    observation = observe(robot.chain, effects, covariance=noise)
    family: Fourier | Spline = Fourier(args.order, 1.0 / args.duration)
    if args.family == "spline":
        family = Spline(args.duration, 2 * args.order)
    with screen.working(f"designing for {observation.size} parameters"):
        found = design(
            robot,
            observation,
            family,
            seed=args.seed,
            criterion=_CRITERIA[args.criterion],
            limits=limits,
            constraints=_constraints(args, robot, limits),
            trajectories=args.trajectories,
            starts=args.starts,
            together=args.together,
            rate=grid,
        )
    found.save(args.out, rate=args.rate, more={"provenance": args.how})
    motion, information, postures = pictures
    reference = found.trajectories[0].reference(50.0)
    save_figure(motion_figure(reference, robot.joints, limits), motion)
    save_figure(information_figure(found), information)
    save_figure(postures_figure(robot, reference), postures)
    options.write_record(args, found.as_dict())
    _tell(args, screen, found)
    options.warn_of_others(args.out, outputs)


def _tell(args: Namespace, screen: Screen, found: Design) -> None:
    count = found.observation.size
    screen.say(
        f"{found.robot.name}: {counted(len(found.trajectories), 'motion')} of "
        f"{args.duration:g} s for {counted(count, 'parameter')} in {args.out}"
    )
    conditions = found.rigid_conditions.items()
    named = ", ".join(f"{x:.4g} ({columns})" for columns, x in conditions)
    screen.say(f"condition of the rigid body in SI units {named}")
    whitened = "" if args.criterion == "condition" else ", whitened"
    screen.say(
        f"of all {count} columns{whitened}: "
        f"condition {found.condition:.4g}, log det {found.log_det:.4g}"
    )
    if args.criterion == "error":
        screen.say(f"expected torque error on random motions {found.value:.3g} N·m")
    if len(found.trajectories) > 1:
        parts = ", ".join(f"{100 * x:.0f} %" for x in found.additions[1:])
        screen.say(f"each further motion shortens the mean standard error by {parts}")
    name, worst = max(found.excess.items(), key=lambda item: item[1])
    screen.say(
        f"nearest limit: {name}, {-100 * worst:.2g} % away, where {args.fill:.0%} of "
        "the file's limits are used (--fill)"
    )
    asked = {"links that meet (--clearance)": args.clearance}
    asked["a floor (--floor)"] = args.floor
    if left_out := [what for what, given in asked.items() if given is None]:
        screen.say(f"not looked at: {', '.join(left_out)}")


def _constraints(args: Namespace, robot: Robot, limits: Limits) -> list[Constraint]:
    found: list[Constraint] = []
    if args.clearance is not None:
        found.append(Clearance.of(robot, limits, margin=args.clearance))
    if args.floor is not None:
        if not np.isfinite(args.floor):
            raise HybridError("--floor is a height in m")
        found.append(Floor(robot, capsules_from_robot(robot), args.floor))
    return found
