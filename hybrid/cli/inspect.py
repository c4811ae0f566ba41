"""``hybrid inspect``: what logs hold, what they tell, and what is wrong with them."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.inspect import inspect_recording
from hybrid.report.inspection import (
    clocks_table,
    doubts_table,
    joints_table,
    readings_tables,
    untold_sentences,
    verdict,
    write_inspection,
)
from hybrid.shown import counted

HELP = """\
shows how each file was read, its clock, what every joint does, and what the logs cannot
tell. With a robot, order, sign, unit and clock are held against physics. Exit code 2 if
a log would mislead. Logs without torque are taken as well.

--json: provenance, logs (source, clock, channels, joints, excitation, doubts,
misleads).

examples:
  hybrid inspect logs
  hybrid inspect logs --robot models/scara.xml --page inspection.html"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "recordings", nargs="+", metavar="PATH", help="files, folders or globs"
    )
    options.add(parser, "--map")
    options.add_robot(parser, required=False, more=", to hold the logs against physics")
    words = "write all of it, with a picture"
    options.option(parser, "--page FILE.html", words, type=Path)


def run(args: Namespace, screen: Screen) -> None:
    """Inspect, write and show; refuse what would mislead."""
    if args.page and args.page.suffix.lower() not in (".html", ".htm"):
        raise HybridError(f"{args.page}: a page is saved as .html")
    robot = options.load_robot(args) if args.robot else None
    joints = robot.joints if robot else None
    recordings = options.read_logs(args, screen, joints, torque=False)
    options.begin(args, args.page)
    with screen.working(f"inspecting {counted(len(recordings), 'recording')}"):
        found = [inspect_recording(x, robot) for x in recordings]
    options.write_record(args, {"logs": [x.as_dict() for x in found]})
    if args.page:
        write_inspection(args.page, found, provenance=args.how)
    screen.show(*readings_tables(found), clocks_table(found), joints_table(found))
    screen.show(doubts_table(found))
    for sentence in untold_sentences(found):
        screen.say(sentence)
    screen.say(verdict(found))
    for x in found:
        for doubt in x.doubts:
            if doubt.is_error:
                raise HybridError(f"{x.recording.source}: {doubt.line}")
