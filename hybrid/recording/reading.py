"""Report of how a log was read: the channel of each column, and the unused columns."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Used:
    """One column that was read.

    Attributes:
        index: Index of the column in its table; -1 for a rate in place of a clock.
        label: Label in the file.
        channel: ``t``, or the field of the recording.
        joint: Joint of the column; empty for time.
        unit: Unit in the file; that of SI if none is stated.
        stated: Whether the file, its format or the map states the unit.
        factor: Factor from the file's numbers to SI.
        offset: Offset that is added after that.
    """

    index: int
    label: str
    channel: str
    joint: str
    unit: str
    stated: bool = False
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Reading:
    """Report of how a recording was read.

    Attributes:
        kind: Name of the format.
        name: Name of the recording in the file, such as an episode or a topic.
        preset: Preset that was used; empty if none was.
        columns: Columns that were read, time first.
        aside: Label of each column that was not read, and the reason.
        notes: Further notes, one line each.
    """

    kind: str
    name: str
    preset: str
    columns: tuple[Used, ...]
    aside: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """A line for each column: what it became, in which unit, or why it did not."""
        lines = [f"{self.kind}{f', preset {self.preset}' if self.preset else ''}"]
        lines += [
            f"{x.label}: {x.channel} {x.joint}".rstrip()
            + f" [{x.unit.replace('*', '·')}{'' if x.stated else ', assumed'}]"
            for x in self.columns
        ]
        lines += [f"{label}: set aside, {why}" for label, why in self.aside]
        return "\n".join([*lines, *self.notes])

    @property
    def time(self) -> Used:
        """Column of time."""
        return self.columns[0]

    @property
    def channels(self) -> dict[str, tuple[Used, ...]]:
        """Columns of each channel in the order of the joints."""
        found: dict[str, tuple[Used, ...]] = {}
        for u in self.columns[1:]:
            found[u.channel] = (*found.get(u.channel, ()), u)
        return found

    def as_dict(self) -> dict[str, Any]:
        """Content for JSON."""
        return asdict(self) | {
            "aside": [{"label": label, "why": why} for label, why in self.aside]
        }
