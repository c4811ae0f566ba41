"""Reasons to mistrust a log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hybrid.errors import RecordingError, warn

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Doubt:
    """One reason to mistrust a log.

    Attributes:
        channel: Field of the recording: ``t``, ``q``, ``v``, ``tau`` or ``command``.
        joints: Columns concerned, counted from 0; empty for all, and for the clock.
        text: What the log looks like, and where.
        remedy: What is valid, or what to do.
        severity: With an ``error`` a model of the log is wrong, with a ``warning`` it
            may be.
        evidence: Size of the fault: a factor, a share or a count, as the text says;
            NaN without one.
        rows: Whether it concerns single rows, which may be left out.
    """

    channel: str
    joints: tuple[int, ...]
    text: str
    remedy: str = ""
    severity: Severity = "warning"
    evidence: float = np.nan
    rows: bool = False

    @property
    def line(self) -> str:
        """Text and remedy in one line."""
        return f"{self.text}; {self.remedy}" if self.remedy else self.text

    @property
    def is_error(self) -> bool:
        """Whether the log must not be used."""
        return self.severity == "error"


def error_if(condition: bool) -> Severity:
    """An error if the condition holds, else a warning."""
    return "error" if condition else "warning"


def raise_or_warn(doubts: Sequence[Doubt], source: str, *, rows: bool = True) -> None:
    """Raise the first doubt that is an error; without one, warn of all.

    Args:
        doubts: Doubts, most serious first.
        source: Where the log comes from, for messages.
        rows: Whether an error in single rows is raised as well.
    """
    place = source or "recording"
    for doubt in doubts:
        if doubt.is_error and (rows or not doubt.rows):
            raise RecordingError(f"{place}: {doubt.line}")
    for doubt in doubts:
        warn(f"{place}: {doubt.line}")
