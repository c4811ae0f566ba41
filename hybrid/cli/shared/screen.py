"""The terminal: results on stdout, everything about the run on stderr."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

from rich.console import Console
from rich.progress import Progress as Bar
from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

from hybrid.errors import HybridWarning
from hybrid.progress import Progress
from hybrid.report.table import Table, terminal_table

_WIDTH_OF_A_FILE = 160  # characters
_SHORT = 1.0  # s: a shorter step gets no line of its own in a file
_GUESSED = 0.05  # of the work: before, the remaining time is not shown


class Screen:
    """Where a verb shows its results, its progress and its warnings."""

    def __init__(self) -> None:
        self._out = _console()
        self._err = _console(stderr=True)

    def say(self, text: str = "") -> None:
        """Show a line of results, however long."""
        self._out.print(text, soft_wrap=True)

    def show(self, *tables: Table) -> None:
        """Show tables that have rows.

        The last column of words is folded to the terminal. A narrow terminal wraps
        lines of numbers, so that no digit is lost.
        """
        before = self._out.width
        for table in (x for x in tables if x.rows):
            rich, options = terminal_table(table), self._out.options.update(width=1000)
            if not table.words:
                widest = self._out.measure(rich, options=options).maximum
                self._out.width = max(widest, before)
            with self._out.capture() as captured:
                self._out.print(rich, crop=False, soft_wrap=True)
            self._out.width = before
            lines = captured.get().splitlines()
            print("\n".join(line.rstrip() for line in lines))  # rich pads them

    @contextmanager
    def working(self, text: str) -> Iterator[Progress]:
        """Show what is being done, for how long, and how long it will take.

        A terminal shows one line that changes. Elsewhere each step that takes more than
        a second is a line. The function that is yielded receives each step.
        """
        description = TextColumn("{task.description}", markup=False)
        is_terminal, start = self._err.is_terminal, monotonic()
        last = start
        with Bar(
            SpinnerColumn(),
            description,
            TimeElapsedColumn(),
            console=self._err,
            transient=True,
            disable=not is_terminal,
        ) as bar:
            task = bar.add_task(text, total=None)

            def tell(text: str, done: float | None = None, /) -> None:
                nonlocal last
                now = monotonic()
                text += _left(now - start, done)
                if is_terminal:
                    bar.update(task, description=text)
                elif now - last > _SHORT:
                    self._err.print(f"{now - start:.0f} s: {text}", soft_wrap=True)
                    last = now

            yield tell

    @contextmanager
    def warnings(self) -> Iterator[None]:
        """Show each warning once, in one line."""
        shown: set[str] = set()

        def show(message: Any, category: type[Warning], *_: Any, **__: Any) -> None:
            kind = "" if issubclass(category, HybridWarning) else category.__name__
            words = f"{kind}: {message}" if kind else str(message)
            line = f"warning: {' '.join(words.split())}"
            if line not in shown:
                shown.add(line)
                self._err.print(line, style="yellow", soft_wrap=True)

        with warnings.catch_warnings():
            warnings.simplefilter("always", HybridWarning)
            warnings.showwarning = show
            yield


def _left(elapsed: float, done: float | None) -> str:
    """The remaining time, if the work goes on at the same rate."""
    if done is None or not _GUESSED <= done < 1.0:
        return ""
    return f" (about {elapsed * (1.0 - done) / done:.0f} s left)"


def _console(*, stderr: bool = False) -> Console:
    console = Console(stderr=stderr, highlight=False, markup=False, emoji=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _WIDTH_OF_A_FILE
    return console
