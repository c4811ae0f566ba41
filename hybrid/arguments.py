"""Tell a caller who passes an argument of another type what is right."""

from collections.abc import Iterable
from typing import Any

from hybrid.errors import HybridError

ROBOT = "robot; valid is a Robot, as Robot.load('arm.urdf') gives"
RECORDING = "recording; valid are recordings, as read_recordings('logs') gives"
MODEL = "model; valid is a DynamicModel, as fit.model or DynamicModel.load gives"


def check_argument(
    value: object,
    kind: type | tuple[type, ...],
    words: str,
    error: type[HybridError] = HybridError,
) -> None:
    """Refuse an argument of another type; ``words`` say what is valid."""
    if not isinstance(value, kind):
        shown = repr(value) if isinstance(value, str) else type(value).__name__
        raise error(f"{shown} is no {words}")


def listed(values: Any, kind: type | tuple[type, ...], words: str) -> list[Any]:
    """Items of a type, of which a single one stands for a list of one.

    Raises:
        HybridError: An item is of another type.
    """
    one = isinstance(values, str) or not isinstance(values, Iterable)
    items = [values] if one else list(values)
    for item in items:
        check_argument(item, kind, words)
    return items
