"""``hybrid validate``: errors of a model on recordings it has not seen."""

from argparse import ArgumentParser, Namespace

from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.identification import validate
from hybrid.model.dynamic_model import check_same_arm
from hybrid.report import table_from_validation
from hybrid.report.table import shared_unit
from hybrid.shown import counted

HELP = """\
shows the RMS torque error of the model and of its simpler versions, joint by joint,
over samples at which the joint moves, and the noise floor where the recordings tell it.

--json: provenance, robot, joints, units, rows (name, rms, relative, mean), reduction,
noise_floor, sources, samples, seconds.

example:
  hybrid validate --robot models/scara.xml --model model.json --recordings held_out \\
      --json validation.json"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(
        parser, required=False, more=", to be sure that it is the model's"
    )
    options.add(parser, "--model", "--recordings", "--map")


def run(args: Namespace, screen: Screen) -> None:
    """Validate and show."""
    model = options.load_model(args, args.model)
    robot = options.load_robot(args) if args.robot else model.robot
    check_same_arm(model, robot)  # before a recording is blamed for it
    recordings = options.read_logs(args, screen, robot.joints)
    options.begin(args)
    with screen.working(f"validating on {counted(len(recordings), 'recording')}"):
        validation = validate(model, recordings, robot=robot)
    options.write_record(args, validation.as_dict())
    screen.show(table_from_validation(validation))
    bar, last = validation.reference, validation.rows[-1]
    change, unit = validation.reduction, shared_unit(validation.units)
    screen.say(
        f"{last.name}: {abs(change):.1%} {'more' if change < 0 else 'less'} mean RMS "
        f"than {bar.name}, {last.mean:.4g} instead of {bar.mean:.4g} {unit}"
        if last is not bar
        else f"{last.name}: {last.mean:.4g} {unit} mean RMS, the least of all models"
    )
