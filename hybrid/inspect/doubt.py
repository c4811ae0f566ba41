"""Reasons to mistrust a log."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hybrid.errors import HybridWarning, RecordingError

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Doubt:
    """One reason to mistrust a log.

    Attributes:
        channel: Field of the recording: ``t``, ``q``, ``v``, ``tau`` or ``command``.
        joints: Columns it is about, counted from 0; empty for all, and for the clock.
        text: What the log looks like, and where, in words.
        remedy: What is valid, or what to do.
        severity: An ``error`` makes a wrong model of the log, a ``warning`` may.
        evidence: How far what was read is off: a factor, a share or a count, as the
            text says; NaN without one.
        rows: Whether it is about single rows, which may be left out.
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
        """The whole as one line."""
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


def is_error(doubt: Doubt) -> bool:
    """Whether a doubt forbids to use the log."""
    return doubt.severity == "error"


def error_if(wrong: bool) -> Severity:
    """How serious a doubt is."""
    return "error" if wrong else "warning"


def act_on(doubts: Sequence[Doubt], source: str, *, rows: bool = True) -> None:
    """Refuse a log if one of its doubts is an error; warn of the others.

    Args:
        doubts: What was found, the weightiest first.
        source: Where the log came from, for messages.
        rows: Whether single rows that are wrong are reason enough to refuse it.
    """
    place = source or "recording"
    for doubt in filter(is_error, doubts):
        if rows or not doubt.rows:
            raise RecordingError(f"{place}: {doubt.line}")
    for doubt in doubts:
        warnings.warn(f"{place}: {doubt.line}", HybridWarning, stacklevel=3)
