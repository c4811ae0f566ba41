"""Table of named columns that the reader of a format returns; columns load later."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from hybrid.arrays import AnyArray
from hybrid.errors import HybridError, RecordingError
from hybrid.names import printable

LARGEST_FILE = 4 << 30  # bytes; an hour at 1 kHz of 50 joints is less
MOST_COLUMNS = 20_000  # of a table

Load = Callable[[tuple[int, ...]], list[dict[int, AnyArray]]]


@dataclass(frozen=True)
class LogTable:
    """Named columns on one clock.

    Attributes:
        source: File or folder.
        labels: Label of each column in the file.
        load: Loads the columns of the given indices, in successive blocks of rows:
            index -> samples, shape (N,). A stream keeps no copy of its blocks, so that
            they load only once.
        clock_unit: Unit of the first column, if it is a clock by its format.
        joints: Joint names of the file, for numbered columns.
        kind: Name of the format.
        name: Name of the recording or topic in the source; empty if it has only one.
        preset: Name of the preset of the format.
        home: Name for warnings in place of the source. Episodes name their dataset, so
            that a thousand of them cause one warning.
        note: Note of the reader, in one line.
    """

    source: str
    labels: tuple[str, ...]
    load: Load
    clock_unit: str = ""
    joints: tuple[str, ...] | None = None
    kind: str = ""
    name: str = ""
    preset: str = ""
    home: str = ""
    note: str = ""

    @property
    def place(self) -> str:
        """Source, and the part of it, for messages."""
        return f"{self.source} ({self.name})" if self.name else self.source


@contextmanager
def as_recording_error(source: object, kind: str) -> Iterator[None]:
    """Turn any exception of a library that reads a damaged file into one line."""
    try:
        yield
    except HybridError:
        raise
    except Exception as error:  # libraries raise any type for a damaged file
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise RecordingError(
            f"{source}: not a whole {kind} (truncated?): {reason}"
        ) from error


def check_most(place: object, count: int, what: str, most: int = LARGEST_FILE) -> None:
    """Refuse more than any log has, before memory is taken for it."""
    if count > most:
        raise RecordingError(f"{place}: {count} {what}; valid are up to {most}")


def check_numbers(
    x: AnyArray, label: str, place: str, *, timed: bool, most_axes: int = 1
) -> None:
    """Refuse samples that are no numbers, or have too many axes; time may be dates."""
    kinds = "fiuM" if timed else "fiu"
    if not 1 <= x.ndim <= most_axes or x.dtype.kind not in kinds:
        raise RecordingError(
            f"{place}: {printable(label)} has shape {x.shape} and type {x.dtype}; "
            "valid are numbers, (N,) or (N, n)"
        )


class NoJointsError(RecordingError):
    """A valid file has no joint positions; the message says what it has."""
