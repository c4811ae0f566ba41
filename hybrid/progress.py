"""What a verb that takes its time tells while it works."""

from typing import Protocol


class Progress(Protocol):
    """Called at each step with its name, and the part of all work done, or None."""

    def __call__(self, text: str, done: float | None, /) -> None:
        """Take note of a step."""


def silent(text: str, done: float | None, /) -> None:
    """A progress that nobody looks at."""
