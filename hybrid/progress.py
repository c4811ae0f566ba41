"""What a verb that takes its time tells while it works."""

from typing import Protocol


class Progress(Protocol):
    """Called at each step of the work."""

    def __call__(self, text: str, done: float | None = None, /) -> None:
        """Take note of a step.

        Args:
            text: What is being done now.
            done: Part of the whole work that is behind it, 0 to 1, if known.
        """


def silent(text: str, done: float | None = None, /) -> None:
    """A progress that nobody looks at."""
