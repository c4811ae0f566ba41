"""What a reader of a format yields: named columns that are loaded when needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from hybrid.errors import RecordingError

LARGEST_FILE = 4 << 30  # bytes: an hour at 1 kHz of 50 joints is less
MOST_COLUMNS = 20_000  # of a table: more are no log of an arm

Load = Callable[[tuple[int, ...]], list[dict[int, NDArray[Any]]]]


@dataclass(frozen=True)
class LogTable:
    """Named columns on one clock.

    Attributes:
        source: File or folder that it comes from.
        labels: Label of each column, as the file has it.
        load: Gives the samples of columns by their indices, in blocks of rows, one
            after the other: index -> shape (N,). A stream gives its blocks away, so
            that a log is never held twice: the numbers can be had once.
        units: Unit that the file states for each column apart from its label; empty
            strings where it states none, or no strings at all.
        joints: Joint names of the file, for columns that are only numbered.
        kind: Name of the format.
        name: Which recording or topic of the source it is; empty if there is one.
        preset: Name of the preset that the format itself stands for.
        home: What warnings name instead of the source: the dataset of an episode, so
            that a thousand episodes are warned of once.
        note: What the reader decided, in one line; empty if nothing.
    """

    source: str
    labels: tuple[str, ...]
    load: Load
    units: tuple[str, ...] = ()
    joints: tuple[str, ...] | None = None
    kind: str = ""
    name: str = ""
    preset: str = ""
    home: str = ""
    note: str = ""

    @property
    def place(self) -> str:
        """Words for messages: the source, and which part of it."""
        return f"{self.source} ({self.name})" if self.name else self.source

    def unit(self, index: int) -> str:
        """Unit that the file states for a column apart from its label."""
        return self.units[index] if self.units else ""


@contextmanager
def whole(source: object, kind: str) -> Iterator[None]:
    """Turn whatever a library raises of a damaged file into one line."""
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:  # a damaged file ends in any error of any library
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise RecordingError(
            f"{source}: not a whole {kind} (truncated?): {reason}"
        ) from error


class NoJointsError(RecordingError):
    """A valid file without any joint channel; the message says what it has."""
