"""Child processes for units, which can be killed if one hangs.

Each thread of a Dask worker keeps one child with all modules loaded. Questions and
answers are lines of JSON. A child that takes too long, or dies, is replaced.
"""

from __future__ import annotations

import json
import os
import queue
import selectors
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

UNIT = "hybrid.fleets.unit"
# Status of a unit.
OK, REFUSED, LATE, LOST = "ok", "refused", "late", "lost"
VERDICT, FINDING = "verdict", "finding"  # rows of a diagnosis
_START = 300.0  # s for a child to load on a busy machine
_TRIES = 2  # since the system may kill a child that is not at fault
_SINGLE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_children: dict[tuple[int, str], Child] = {}  # by thread and module


class Child:
    """A process that runs a module and answers one question at a time."""

    def __init__(self, module: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
            env={**os.environ, **dict.fromkeys(_SINGLE, "1")},
        )
        try:
            self._read(_START)
        except (TimeoutError, EOFError):
            self.end()
            raise

    def ask(self, question: str, limit: float) -> dict[str, Any]:
        """The answer to a question of one line.

        Raises:
            TimeoutError: It took longer than ``limit``, [s].
            EOFError: The child died.
        """
        assert self.process.stdin
        try:
            self.process.stdin.write(f"{question}\n")
            self.process.stdin.flush()
        except OSError as error:
            raise EOFError(str(error)) from error
        return self._read(limit)

    def _read(self, limit: float) -> dict[str, Any]:
        assert self.process.stdout
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            if not selector.select(limit):
                raise TimeoutError
        line = self.process.stdout.readline()
        if not line.endswith("\n"):
            raise EOFError(f"its process ended with {self.process.wait()}")
        return dict(json.loads(line))

    def end(self) -> None:
        """Kill the child."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream:
                with suppress(OSError):  # of unread data
                    stream.close()


def ask(
    message: Mapping[str, Any], model: str | None, limit: float, module: str = UNIT
) -> dict[str, Any]:
    """The answer of this thread's child; a timeout or death is an answer too.

    The message is one of :func:`hybrid.fleets.unit.answer`, the model the text of the
    baseline, and the limit the longest time, [s].
    """
    question, reason = json.dumps({**message, "model": model}), ""
    own = threading.get_ident(), module
    for _ in range(_TRIES):
        try:
            if own not in _children:
                _children[own] = Child(module)
            return _children[own].ask(question, limit)
        except TimeoutError:
            _drop(own)
            return {"failed": LATE, "reason": f"no result within {limit:g} s"}
        except EOFError as error:
            _drop(own)
            reason = str(error)
    return {"failed": LOST, "reason": reason}


def ask_each(
    messages: Sequence[Mapping[str, Any]], model: str | None, limit: float, module: str
) -> tuple[list[dict[str, Any]], float]:
    """The answers to some messages, see :func:`ask`, and the time they took, [s]."""
    start = time.monotonic()
    found = [ask(x, model, limit, module) for x in messages]
    return found, time.monotonic() - start


def _drop(own: tuple[int, str]) -> None:
    if child := _children.pop(own, None):
        child.end()


def end_children() -> None:
    """End all children of this process."""
    while _children:
        _children.popitem()[1].end()


def serve(answer: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> None:
    """Answer questions, one line of JSON each, until the parent process ends.

    The process ends with its parent or the pipe, even during a computation. Output of
    libraries goes to stderr. An exception is an answer, since a bug must not stop the
    fleet.
    """
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    questions: queue.Queue[str] = queue.Queue()

    def listen() -> None:
        for line in sys.stdin:
            questions.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    content: Mapping[str, Any] = {}  # ready
    while True:
        out.write(f"{json.dumps(content)}\n")
        out.flush()
        try:
            content = answer(json.loads(questions.get()))
        except Exception as error:
            content = {"failed": REFUSED, "reason": f"{type(error).__name__}: {error}"}
