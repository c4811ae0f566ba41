"""The command ``hybrid``: arguments -> verb -> exit code.

One verb = one file = one public function. Only this package prints.
"""

from __future__ import annotations

import io
import os
import sys
from argparse import Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence

from hybrid import __version__
from hybrid.cli import (
    calibrate,
    demo,
    diagnose,
    effects,
    excite,
    export,
    fleet,
    identify,
    inspect,
    predict,
    simulate,
    track,
    validate,
)
from hybrid.cli.shared.options import Parser
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError
from hybrid.names import printable

__all__ = ["build_parser", "main"]

OK, BUG, BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141

_MODULES = (
    demo, inspect, excite, simulate, identify, validate, predict, track, calibrate,
    diagnose, fleet, export, effects,
)  # fmt: skip
_VERBS = {module.__name__.rpartition(".")[2]: module for module in _MODULES}
_EXAMPLES = """\
a real log, in ten seconds:
  hybrid demo

from nothing to a validated model:
  hybrid simulate --robot models/coman_truth.yaml --seed 0 --out logs/fit
  hybrid simulate --robot models/coman_truth.yaml --seed 1 --out logs/held_out
  hybrid identify --robot models/coman_like.xml --recordings logs/fit --out model.json
  hybrid validate --model model.json --recordings logs/held_out
  hybrid predict --model model.json --recording logs/held_out/trajectory_1.csv \\
      --out tau.csv

exit codes: 0 done, 2 bad input (one line on stderr says what is valid), 130 Ctrl-C
'hybrid VERB --help' tells more"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments; those of the process by default.

    Returns:
        Exit code: 0, 2 for bad input, 130 after Ctrl-C, 1 for an error in this program.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # "±" on a terminal of 1985
    try:
        _run(_parsed(argv))
    except HybridError as error:
        return _fail(BAD_INPUT, str(error))
    except KeyboardInterrupt:
        return _fail(INTERRUPTED, "interrupted; nothing is half-written")
    except BrokenPipeError:
        # 'hybrid effects | head': whoever read has enough. Python flushes once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(BAD_INPUT, f"{where}{error.strerror or error}")
    except Exception as error:
        if os.environ.get("HYBRID_DEBUG"):
            raise
        return _fail(
            BUG,
            f"{type(error).__name__}: {error} (an error of this program, please "
            "report it; HYBRID_DEBUG=1 shows where it is)",
        )
    return OK


def build_parser() -> Parser:
    """The parser of all verbs; building it imports nothing heavy."""
    parser = Parser(
        prog="hybrid",
        description="Identify the drive torque of a robot arm from logs of its joints: "
        "rigid body + effects + a learned remainder.",
        epilog=_EXAMPLES,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hybrid {__version__}")
    verbs = parser.add_subparsers(metavar=f"{{{','.join(_VERBS)}}}", required=True)
    for name, module in _VERBS.items():
        first_line, rest = module.HELP.split("\n", 1)
        verb = verbs.add_parser(
            name,
            help=first_line,
            description=first_line,
            epilog=rest.strip("\n"),
            formatter_class=RawDescriptionHelpFormatter,
        )
        module.add_arguments(verb)
        verb.set_defaults(verb=name, parser=verb)
    return parser


def _parsed(argv: Sequence[str] | None) -> Namespace:
    args, unknown = build_parser().parse_known_args(argv)
    if unknown:
        args.parser.error(f"unknown {' '.join(unknown)}")
    args.inputs = []  # files that the result depends on, as they are loaded
    return args


def _run(args: Namespace) -> None:
    from hybrid.threads import one_thread

    screen = Screen()
    with screen.warnings():
        if args.effects_from:
            from hybrid.effects import effects_from_file

            for path in args.effects_from:
                effects_from_file(path)
        one_thread(_VERBS[args.verb].run)(args, screen)
        sys.stdout.flush()


def _fail(code: int, text: str) -> int:
    print(f"error: {printable(' '.join(text.split()))}", file=sys.stderr)
    return code
