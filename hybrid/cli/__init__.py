"""The command ``hybrid``: arguments -> verb -> exit code.

One verb = one file = one public function. Only this package prints.
"""

import io
import os
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Collection, Sequence
from importlib import import_module
from signal import SIGTERM, signal
from threading import current_thread, main_thread
from typing import Any, NoReturn

from hybrid import __version__
from hybrid.errors import HybridError
from hybrid.names import printable

__all__ = ["build_parser", "main"]

OK, BUG, BAD_INPUT, INTERRUPTED, BROKEN_PIPE, TERMINATED = 0, 1, 2, 130, 141, 143

_VERBS = {
    "demo": "identify a UR10 from a real log that comes with the package",
    "inspect": "look at recordings before anything is fitted to them",
    "excite": "design the motion that reveals the parameters",
    "simulate": "simulate motions of an arm with effects that its file does not know",
    "identify": "identify the drive torque of an arm from recordings",
    "validate": "score a model on recordings that it was not identified from",
    "predict": "predict the drive torque along a recording",
    "track": "track the parameters of a model along a recording, sample by sample",
    "calibrate": "calibrate the geometry of an arm from measured poses",
    "diagnose": "say what a simulator lacks: where, which effect, and by how much the "
    "gap shrinks",
    "fleet": "say which arms of a fleet change, when and in what, and which are unlike "
    "the others",
    "export": "export a model to C, ONNX, TorchScript, MJCF, URDF, Isaac Lab or JSON",
    "effects": "list effects, or tell all about one",
}
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

exit codes: 0 done, 2 bad input (one line on stderr says what is valid), 130 Ctrl-C,
            143 SIGTERM
'hybrid VERB --help' tells more"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments; those of the process by default.

    Returns:
        Exit code: 0, 2 for bad input, 130 after Ctrl-C, 143 after SIGTERM, 1 for an
        error in this program.
    """
    if current_thread() is main_thread():
        signal(SIGTERM, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # "±" on a terminal of 1985
    try:
        _run(_parsed(sys.argv[1:] if argv is None else argv))
    except HybridError as error:
        return _fail(BAD_INPUT, str(error))
    except _Terminated:
        return _fail(TERMINATED, "terminated; nothing is half-written")
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


class _Terminated(KeyboardInterrupt):
    """SIGTERM ends the work as Ctrl-C does."""


def _terminate(*_: Any) -> NoReturn:
    raise _Terminated


class Parser(ArgumentParser):
    """An argument parser that reports an error as one line with what is valid."""

    def __init__(self, **options: Any) -> None:
        super().__init__(
            allow_abbrev=False, formatter_class=RawDescriptionHelpFormatter, **options
        )

    def error(self, message: str) -> NoReturn:
        """See :meth:`argparse.ArgumentParser.error`."""
        if "choose from" not in message:
            message += f"; {' '.join(self.format_usage().split())}"
        raise HybridError(message)


def build_parser(known: Collection[str] = tuple(_VERBS)) -> Parser:
    """The parser of the command line.

    Args:
        known: Verbs whose arguments it knows; the modules of the others, which may be
            heavy, are not imported.
    """
    parser = Parser(
        prog="hybrid",
        description="Identify the drive torque of a robot arm from logs of its joints: "
        "rigid body + effects + a learned remainder.",
        epilog=_EXAMPLES,
    )
    parser.add_argument("--version", action="version", version=f"hybrid {__version__}")
    verbs = parser.add_subparsers(metavar=f"{{{','.join(_VERBS)}}}", required=True)
    for name, does in _VERBS.items():
        verb = verbs.add_parser(name, help=does, description=does)
        if name in known:
            module = import_module(f"hybrid.cli.{name}")
            options = import_module("hybrid.cli.shared.options")
            verb.epilog = module.HELP
            module.add_arguments(verb)
            options.add(verb, "--effects-from", "--json")
            verb.set_defaults(run=module.run, verb=name, parser=verb)
    return parser


def _parsed(argv: Sequence[str]) -> Namespace:
    asked = [word for word in argv if word in _VERBS][:1]
    parser = build_parser(asked)
    if not argv:
        parser.print_help()
        raise SystemExit(BAD_INPUT)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        args.parser.error(f"unknown {' '.join(unknown)}")
    args.inputs = []  # files that the result depends on, as they are loaded
    return args


def _run(args: Namespace) -> None:
    from hybrid.cli.shared.screen import Screen
    from hybrid.effects import effects_from_file
    from hybrid.threads import one_thread

    screen = Screen()
    with screen.warnings():
        for path in args.effects_from:
            effects_from_file(path)
        one_thread(args.run)(args, screen)
        sys.stdout.flush()


def _fail(code: int, text: str) -> int:
    print(f"error: {printable(' '.join(text.split()))}", file=sys.stderr)
    return code
