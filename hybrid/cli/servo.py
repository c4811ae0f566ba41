"""Logs without torque, for the verbs that take them: servos fitted by replay."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.cli.options import write_record
from hybrid.errors import HybridError

if TYPE_CHECKING:
    from hybrid.cli.screen import Screen
    from hybrid.recording import Recording
    from hybrid.robot import Robot
    from hybrid.servo import ServoFit


def without_torque(recordings: Sequence[Recording]) -> bool:
    """Whether no log has torque.

    Raises:
        HybridError: Some have and some have not, or a log has neither torque nor
            command.
    """
    lacking = [x for x in recordings if not x.has_torque]
    if lacking and len(lacking) < len(recordings):
        raise HybridError(
            f"{lacking[0].source}: no torque, but other recordings have it; valid are "
            "logs that all have torque, or none"
        )
    for x in lacking:
        if x.command is None:
            raise HybridError(
                f"{x.source}: neither torque nor command; valid are columns of one of "
                "them beside positions"
            )
    return bool(lacking)


def fit(robot: Robot, recordings: Sequence[Recording], screen: Screen) -> ServoFit:
    """Fit servos, with progress."""
    from hybrid.servo import fit_servo

    with screen.working(f"fitting the servos of {robot.name}") as tell:
        return fit_servo(robot, recordings, progress=tell)


def show(found: ServoFit, screen: Screen) -> None:
    """Show errors, what the file has wrong, and what is not known."""
    from hybrid.report import numbers_table
    from hybrid.report.servo import findings_table, gap_table, servos_table

    for table in (gap_table(found), findings_table(found), servos_table(found)):
        if table.rows:
            screen.show_numbers(numbers_table(table))
    for note in found.notes:
        screen.say(f"Note: {note}.")
    screen.say(found.sentence)


def identify_servos(
    args: Namespace,
    robot: Robot,
    recordings: Sequence[Recording],
    how: dict[str, Any],
    screen: Screen,
) -> None:
    """Fit, write the user's simulator with the servos found, and show."""
    from hybrid.servo.write import write_servos

    if args.out.suffix.lower() not in (".xml", ".mjcf"):
        raise HybridError(
            f"{args.out}: of logs without torque comes a simulator; valid is the name "
            "of an .xml file"
        )
    found = fit(robot, recordings, screen)
    refuse_worse(found)
    write_servos(robot, found.drive, args.out)
    write_record(args, how, found.as_dict())
    show(found, screen)
    screen.say(f"simulator: {args.out}")


def diagnose_servos(
    args: Namespace,
    robot: Robot,
    recordings: Sequence[Recording],
    how: dict[str, Any],
    screen: Screen,
) -> None:
    """Fit, write report, numbers and simulator to a folder, and show."""
    from hybrid.files import atomic_folder, write_json
    from hybrid.report.servo import write_servo_page
    from hybrid.servo.write import write_servos

    found = fit(robot, recordings, screen)
    logs = [x for x in recordings if x.source in found.unseen] or list(recordings)
    replay = found.replayed(logs[0])
    with atomic_folder(args.out) as folder:
        content = {**found.as_dict(), "provenance": how}
        write_json(folder / "diagnosis.json", content)
        write_servo_page(folder / "report.html", found, replay, provenance=how)
        write_servos(robot, found.drive, folder / "sim_fixed.xml")
    write_record(args, how, found.as_dict())
    show(found, screen)
    screen.say(f"Report: {Path(args.out) / 'report.html'}")
    screen.say(f"Simulator with what was found: {Path(args.out) / 'sim_fixed.xml'}")
    sys.stdout.flush()


def refuse_worse(found: ServoFit) -> None:
    """Refuse servos that replay unseen motion worse than the file's, as far as seen.

    Raises:
        HybridError: They do.
    """
    if found.after.mean() > found.before.mean() + found.floor.mean():
        raise HybridError(
            f"{found.robot.name}: servos found miss unseen motion by "
            f"{1000 * found.after.mean():.1f} mrad, the file's by "
            f"{1000 * found.before.mean():.1f}: nothing saved; valid are logs of more "
            "varied motion"
        )
