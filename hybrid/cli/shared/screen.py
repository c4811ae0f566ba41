"""The terminal: results on stdout, everything about the run on stderr."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any

from hybrid.errors import HybridWarning
from hybrid.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table as RichTable
    from rich.text import Text

    from hybrid.report import Table

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

    def show(self, content: RenderableType) -> None:
        """Show results folded to the terminal."""
        self._print(content, self._out.width)

    def show_numbers(self, table: Table) -> None:
        """Show a table of numbers; a narrow terminal wraps it, no digit is lost."""
        from hybrid.report import numbers_table

        rich, options = numbers_table(table), self._out.options.update(width=1000)
        width = self._out.measure(rich, options=options).maximum
        self._print(rich, max(width, self._out.width))

    def _print(self, content: RenderableType, width: int) -> None:
        before, self._out.width = self._out.width, width
        with self._out.capture() as captured:
            self._out.print(content, crop=False, soft_wrap=True)
        self._out.width = before
        lines = captured.get().splitlines()
        print("\n".join(line.rstrip() for line in lines))  # rich pads them

    def show_words(self, table: Table) -> None:
        """Show a table of text, its last column folded."""
        self.show(words_table(table.header, table.rows, title=table.caption))

    @contextmanager
    def working(self, text: str) -> Iterator[Progress]:
        """Show what is being done, for how long, and how long it will take.

        A terminal shows one line that changes. Elsewhere each step is a line, but for
        steps of less than a second.

        Yields:
            A function that receives each step.
        """
        from rich.progress import Progress as Bar
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

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


def words_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str | Text]],
    *,
    title: str | None = None,
) -> RichTable:
    """A table of text; only its last column folds."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    table = RichTable(
        box=SIMPLE_HEAD,
        title=None if title is None else Text(title),
        title_justify="left",
        title_style="bold",
        pad_edge=False,
    )
    for k, name in enumerate(header):
        table.add_column(Text(name), no_wrap=k < len(header) - 1)
    for row in rows:
        # As Text, so that a bracket in a name is not taken for markup.
        table.add_row(*(Text(x) if isinstance(x, str) else x for x in row))
    return table


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    console = Console(stderr=stderr, highlight=False, markup=False, emoji=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _WIDTH_OF_A_FILE
    return console
