"""Logs without torque, which ``hybrid identify`` and ``hybrid diagnose`` both take."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.recording import Recording
from hybrid.report.servo import findings_table, gap_table, servos_table
from hybrid.robot import Robot
from hybrid.servo import ServoFit, fit_servo, without_torque

_KNOWN_MASS = (
    "mass of the link that a joint moves, which sets the scale of torques in logs that "
    "have none (default: the file's masses)"
)


def add_arguments(parser: ArgumentParser, *, known_mass: str = _KNOWN_MASS) -> None:
    """Add the arguments of logs without torque, with words on the known masses."""
    masses = {"type": options.positions, "default": {}}
    options.option(parser, "--known-mass JOINT=KG", known_mass, **masses)
    words = "replay logs that have no torque on a GPU, with JAX (same answer)"
    options.option(parser, "--gpu", words, action="store_true")


def check_arguments(
    args: Namespace, recordings: Sequence[Recording], *, weighed: bool = False
) -> bool:
    """Say whether the logs have no torque.

    ``weighed``: whether the verb takes a known mass in logs with torque.

    Raises:
        HybridError: They have, and an argument needs logs that have not; or there is no
            GPU.
    """
    if without_torque(recordings):
        if args.gpu:
            from hybrid.servo.accelerated import check_gpu

            check_gpu()
        return True
    if args.gpu:
        wrong = "--gpu: these logs have torque, and nothing is replayed"
    elif args.known_mass and not weighed:
        wrong = "--known-mass: these logs have torque, which sets the scale, and "
        wrong += "hybrid diagnose settles that"
    else:
        return False
    raise HybridError(f"{wrong}; valid is it with logs of command and position only")


def fit(
    args: Namespace, robot: Robot, recordings: Sequence[Recording], screen: Screen
) -> ServoFit:
    """Fit the servos of an arm as the arguments say."""
    with screen.working(f"fitting the servos of {robot.name}") as tell:
        return fit_servo(
            robot, recordings, known_mass=args.known_mass, gpu=args.gpu, progress=tell
        )


def show(found: ServoFit, screen: Screen) -> None:
    """Show replay errors, wrong parameters of the file, and what is not known."""
    screen.show(gap_table(found), findings_table(found), servos_table(found))
    for note in found.notes:
        screen.say(f"Note: {note}.")
    screen.say(found.sentence)
