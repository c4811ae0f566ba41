"""``hybrid effects``: what can be simulated and found."""

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import Any

from hybrid import effects
from hybrid.cli.shared import options
from hybrid.cli.shared.screen import Screen
from hybrid.effects import Effect, Quantity
from hybrid.errors import HybridError
from hybrid.plant.scale import joint_scales
from hybrid.report import Table
from hybrid.robot import Robot

HELP = """\
an effect has gains, which a fit finds, and shapes, which are given. With a robot, the
usual size of each is shown for each joint, in SI units. Without one, units are those of
a joint that turns; at one that slides, m is in the place of rad, and N in that of N·m.

--json: provenance, effects (effect, port, scope, equation, source, sentence, remedy,
gains, shapes).

examples:
  hybrid effects
  hybrid effects stribeck
  hybrid effects stribeck --robot models/planar.xml
  hybrid effects --effects-from mine.py --json effects.json"""

# By scope: where an effect acts, how its sentence names that, and how it is asked for.
_SCOPES = {
    "joint": ("one joint", "the joint", ":JOINT"),
    "coupling": ("several joints", "these joints", ":JOINT+JOINT"),
    "arm": ("the whole arm", "the arm", ""),
}


def add_arguments(parser: ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("effect", nargs="?", metavar="EFFECT", help="one of them")
    options.add_robot(parser, required=False, more=", to show sizes for")


def run(args: Namespace, screen: Screen) -> None:
    """List or describe."""
    if args.robot and not args.effect:
        raise HybridError("--robot shows the sizes of one effect; name it")
    if args.effect:
        found = [effects.effect_class(args.effect)]
    else:
        found = list(effects.effect_classes().values())
    robot = options.load_robot(args) if args.robot else None
    options.begin(args)
    options.write_record(args, {"effects": [content_from_class(cls) for cls in found]})
    if args.effect:
        _show_one(found[0], screen)
        if robot:
            _show_sizes(found[0], robot, screen)
    else:
        _show_all(found, screen)


def content_from_class(cls: type[Effect]) -> dict[str, Any]:
    """What an effect states about itself, for JSON."""
    return {
        "effect": cls.id,
        "port": cls.port.value,
        "scope": cls.scope,
        "equation": cls.equation,
        "source": cls.source,
        "sentence": cls.sentence,
        "remedy": cls.remedy,
        "gains": [asdict(x) for x in cls.gains],
        "shapes": [asdict(x) for x in cls.shapes],
    }


def _show_all(found: list[type[Effect]], screen: Screen) -> None:
    rows = []
    for cls in found:
        units = ", ".join(
            f"{x.name} [{x.unit}]" if x.unit else x.name
            for x in (*cls.gains, *cls.shapes)
        )
        about = f"{cls.equation}\n{units}\n{_sentence(cls)}"
        rows.append((cls.id, cls.port.value, about))
    header = ("effect", "port", "equation, parameters, sign")
    screen.show(Table(header, tuple(rows), words=True))


def _show_one(cls: type[Effect], screen: Screen) -> None:
    screen.say(f"{cls.id}: {cls.equation}")
    screen.say(_sentence(cls))
    screen.say(f"remedy: {cls.remedy}")
    screen.say(f"source: {cls.source}")
    acts_on, _, place = _SCOPES[cls.scope]
    screen.say(f"port: {cls.port.value}; acts on: {acts_on}")
    kinds = [("gain", x) for x in cls.gains] + [("shape", x) for x in cls.shapes]
    rows = [
        (
            x.name,
            kind,
            x.unit,
            f"{x.typical:g}",
            f"{x.lower:g} to {x.upper:g}",
            _multiples(x),
        )
        for kind, x in kinds
    ]
    header = ("parameter", "kind", "unit", "usual", "plausible", "in multiples of")
    screen.show(Table(header, tuple(rows), words=True))
    value = kinds[0][1].name
    screen.say(f"--effects '{cls.id}{place}' or '{cls.id}{place}({value}=NUMBER)'")


def _show_sizes(cls: type[Effect], robot: Robot, screen: Screen) -> None:
    """Show usual sizes at each joint of an arm, in SI units."""
    rows = [
        (
            joint,
            x.name,
            robot.chain.unit_at(() if cls.scope == "arm" else (k,), x.unit),
            f"{x.typical:.4g}",
            f"{x.lower:.4g} to {x.upper:.4g}",
        )
        for k, (joint, scale) in enumerate(
            zip(robot.joints, joint_scales(robot), strict=True)
        )
        for x in (y.scaled(scale) for y in (*cls.gains, *cls.shapes))
    ]
    header = ("joint", "parameter", "unit", "usual", "plausible")
    screen.show(Table(header, tuple(rows), f"On {robot.name}", words=True))


def _sentence(cls: type[Effect]) -> str:
    text = cls.sentence.replace("{joints}", _SCOPES[cls.scope][1])
    return text[:1].upper() + text[1:]


def _multiples(x: Quantity) -> str:
    parts = [
        name + ("" if power == 1 else f"^{power}")
        for name, power in zip(("rated torque", "rated speed"), x.per, strict=True)
        if power
    ]
    return " · ".join(parts)
