"""The side of a child process that answers its parent's questions."""

import json
import os
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

from hybrid.fleets.worker import REFUSED


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
