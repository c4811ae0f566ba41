"""``hybrid identify``: a dynamic model from recordings."""

from argparse import ArgumentParser, Namespace

from hybrid import identification
from hybrid.cli.shared import options, servos
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.identification import Fit
from hybrid.identification.three_stage import STAGES
from hybrid.report.fit import content_from_fit, effects_table, held_out_table
from hybrid.servo import ServoFit
from hybrid.shown import counted

HELP = """\
writes MODEL.json, one file with a hash of all that it says; shows the error of every
stage on samples left out of the fit, what cannot be told from these recordings, and the
effects found; warns of stages that did not help and of poor excitation.

--json: provenance, robot, joints, stage, cutoff, held_out (RMS of each stage),
left_out, unidentifiable, warnings, converged, rounds, condition, sigma, effects,
unknowns.

logs without torque, but with command: stiffness, damping, friction, rotor, delay and
offset of every servo are found by open-loop replays in MuJoCo, and --out is the robot's
own MJCF file with these servos.

examples:
  hybrid identify --robot models/scara.xml --recordings logs --out model.json
  hybrid identify --robot arm.urdf --recordings 'logs/*.parquet' --estimator wls \\
      --effects spring:elbow,transmission_coupling:5+6 --out model.json"""

_SHOWN = 10  # lines of what is unidentifiable


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    options.add_robot(parser)
    options.add(parser, "--recordings", "--map", "--seed")
    options.add(parser, "--out", metavar="MODEL.json")
    words = "ls, wls or irls (default): the last way to weigh joints that is tried"
    options.option(parser, "--estimator NAME", words, default="irls")
    words = "of rigid, friction, ripple, remainder (default: all); rigid always runs"
    options.option(parser, "--stages LIST", words, type=options.names, default=STAGES)
    words = "more effects whose gains shall be found, as effect[:joint[+joint]]"
    words += "[(shape=value;...)] between commas; see 'hybrid effects'"
    options.option(parser, "--effects LIST", words, default="")
    options.add(parser, "--cutoff")
    words = "weigh down stretches that do not fit"
    options.option(parser, "--robust", words, action="store_true")
    words = "give the links parameters of bodies that could be built"
    options.option(parser, "--consistent", words, action="store_true")
    servos.add_arguments(parser)


def run(args: Namespace, screen: Screen) -> None:
    """Identify, save and show."""
    robot = options.load_robot(args)
    effects = options.load_effects(args.effects, robot, gains=False)
    recordings = options.read_logs(args, screen, robot.joints, torque=False)
    servo = servos.check_arguments(args, recordings)
    if not servo and args.out.suffix != ".json":
        raise HybridError(f"{args.out}: a model is saved as .json")
    if servo and args.out.suffix.lower() not in (".xml", ".mjcf"):
        raise HybridError(
            f"{args.out}: of logs without torque comes a simulator; valid is the name "
            "of an .xml file"
        )
    options.begin(args, args.out)
    if servo:
        _save_servos(servos.fit(args, robot, recordings, screen), args, screen)
        return
    with screen.working(
        f"identifying {robot.name} from {counted(len(recordings), 'recording')}"
    ):
        fit = identification.identify(
            robot,
            recordings,
            estimator=args.estimator,
            stages=args.stages,
            # The size of a gain is what is asked for; its shapes are stated.
            effects=[e.at({g.name: 0.0 for g in e.gains}) for e in effects],
            cutoff=args.cutoff,
            robust=args.robust,
            consistent=args.consistent,
            seed=args.seed,
        )
    fit.model.save(args.out)
    options.write_record(args, content_from_fit(fit))
    _show(fit, screen)
    screen.say(f"model: {args.out}")


def _show(fit: Fit, screen: Screen) -> None:
    screen.show(held_out_table(fit))
    if fit.unidentifiable:
        screen.say("unidentifiable:")
        for text in fit.unidentifiable[:_SHOWN]:
            screen.say(f"  {text}")
        if len(fit.unidentifiable) > _SHOWN:
            screen.say(f"  … and {len(fit.unidentifiable) - _SHOWN} more, see --json")
    screen.show(effects_table(fit))


def _save_servos(found: ServoFit, args: Namespace, screen: Screen) -> None:
    """Write the user's simulator with the servos found, if they replay no worse."""
    if found.after.mean() > found.before.mean() + found.floor.mean():
        raise HybridError(
            f"{found.robot.name}: servos found miss unseen motion by "
            f"{1000 * found.after.mean():.1f} mrad, the file's by "
            f"{1000 * found.before.mean():.1f}: nothing saved; valid are logs of more "
            "varied motion"
        )
    found.save(args.out)
    options.write_record(args, found.as_dict())
    servos.show(found, screen)
    screen.say(f"simulator: {args.out}")
