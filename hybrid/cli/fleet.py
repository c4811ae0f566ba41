"""``hybrid fleet``: many arms over time, and against each other."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.fleets import fleet
from hybrid.fleets.plan import read_plan
from hybrid.report.fleet import fleet_tables, lead_sentence, write_fleet_pages
from hybrid.robot.library import robot_file

HELP = """\
PLAN is a YAML file: robot, arms (a folder with one folder of logs for each arm, or a
table), and any of baseline, track, period, limits, payload, tool, group, time_limit,
false_alarms, diagnose, joints, map. Dates come from the names of the logs. PLAN may be
the folder of arms itself, with --robot.

Results are stored as they come in DIR/units; the same command does what is missing.
DIR/report.html, DIR/arms, DIR/fleet.parquet and DIR/fleet.prom say what was found.

--json: provenance, arm_months, alarms, unlike, refused, diagnoses, shared.

examples:
  hybrid fleet plan.yaml --out fleet
  hybrid fleet logs --robot models/scara.xml --out fleet --workers 2
  hybrid fleet plan.yaml --out fleet --scheduler tcp://10.0.0.1:8786"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("plan", type=Path, metavar="PLAN", help="YAML file, or folder")
    words = "the arms, if PLAN is a folder"
    options.option(parser, "--robot FILE", words, type=robot_file)
    options.add(parser, "--out")
    words = "of a Dask scheduler (default: the cores of this machine)"
    options.option(parser, "--scheduler ADDRESS", words)
    words = "processes here (default: one a core)"
    options.option(parser, "--workers N", words, type=options.count)


def run(args: Namespace, screen: Screen) -> None:
    """Run the fleet, write and show."""
    plan = read_plan(args.plan, robot=args.robot)
    args.inputs += [args.plan] if args.plan.is_file() else []
    options.begin(args, args.out / "report.html")
    with screen.working("looking for logs") as tell:
        found = fleet(
            plan,
            args.out,
            scheduler=args.scheduler,
            workers=args.workers,
            progress=tell,
        )
        tell("writing the report", None)
        page = write_fleet_pages(args.out, found, provenance=args.how)
    tables = fleet_tables(found)
    content = {
        name: [dict(zip(x.header, row, strict=True)) for row in x.rows]
        for name, x in tables.items()
    }
    whole = {"arm_months": found.arm_months, "shared": list(found.shared)}
    options.write_record(args, whole | content)
    screen.show(*(x.filled() for x in tables.values() if x.rows))
    screen.say(lead_sentence(found))
    screen.say(f"report: {page}")
    if len(found.refused) == len(found.rows):
        first = found.refused[0]
        raise HybridError(
            f"no period has a result: {first['arm']}, {first['period']}: "
            f"{first['reason']}"
        )
