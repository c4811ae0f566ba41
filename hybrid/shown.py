"""Results that show themselves as a table, a picture, a page or a data frame."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from math import floor, isfinite, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.extras import check_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _views() -> Any:
    """The module that shows results; it stands on the floor above them all."""
    return import_module("hybrid.views")


class Shown:
    """Base class of results: a fit, a diagnosis, a design, ..."""

    def __repr__(self) -> str:
        return str(_views().text(self))

    def _repr_html_(self) -> str:
        return str(_views().html(self))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the result.

        Args:
            ax: Axes to draw into; those of a new figure by default.

        Returns:
            The axes; ``plot().figure`` is the figure.
        """
        return _views().plot(self, ax)  # type: ignore[no-any-return]

    def to_html(self, path: str | Path) -> None:
        """Write a self-contained HTML page."""
        _views().write_page(self, path)

    def to_frame(self) -> Any:
        """A pandas data frame with one row for each unknown or joint.

        Raises:
            HybridError: pandas is not installed.
        """
        check_extra("pandas", "frames", "A data frame")
        return _views().frame(self)


def plain(x: Any) -> Any:
    """Content in types of JSON: lists for arrays, None for NaN and infinity."""
    if isinstance(x, Mapping):
        return {str(key): plain(value) for key, value in x.items()}
    if hasattr(x, "tolist"):  # of NumPy
        return plain(x.tolist())
    if isinstance(x, (list, tuple)):
        return [plain(value) for value in x]
    return None if isinstance(x, float) and not isfinite(x) else x


def counted(count: int, noun: str) -> str:
    """A number of things in words: ``1 arm``, ``1,200 arms``."""
    return f"{count:,} {noun}{'s' * (count != 1)}"


def decimals_of(size: float, digits: int, *, most: int = 9) -> int:
    """Decimals with which a size has some significant digits."""
    return min(max(digits - 1 - floor(log10(size)), 0), most)
