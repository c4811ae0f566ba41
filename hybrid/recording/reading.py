"""How a log was read: the channel of each column, and the unused columns."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Used:
    """One column that was taken.

    Attributes:
        index: Its place in the table, from 0; -1 for a rate in place of a clock.
        label: Its label in the file.
        channel: ``t``, or the field of the recording.
        joint: Joint that it belongs to; empty for time.
        unit: Unit in the file; the one of SI if none is stated.
        stated: Whether the file, its format or the map states the unit.
        factor: What its numbers were multiplied with.
        offset: What was added after that.
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
    """How a recording was read.

    Attributes:
        kind: Name of the format.
        name: Which recording of the file, such as an episode or a topic.
        preset: Preset that applied; empty if none did.
        columns: The columns taken, time first.
        aside: Label and reason of each column that was not.
        notes: What else was decided, one line each.
    """

    kind: str
    name: str
    preset: str
    columns: tuple[Used, ...]
    aside: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> Used:
        """The column of time."""
        return self.columns[0]

    @property
    def channels(self) -> dict[str, tuple[Used, ...]]:
        """The columns of each channel in the order of the joints."""
        found: dict[str, tuple[Used, ...]] = {}
        for u in self.columns[1:]:
            found[u.channel] = (*found.get(u.channel, ()), u)
        return found

    def as_dict(self) -> dict[str, Any]:
        """The same in words and numbers of JSON."""
        return asdict(self) | {
            "aside": [{"label": label, "why": why} for label, why in self.aside]
        }
