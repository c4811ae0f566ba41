"""Results that show themselves: as a table in a notebook, a picture, a data frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from hybrid.extras import check_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Shown:
    """What every result can do for its reader: a fit, a diagnosis, a design, ...

    The package puts the module that makes tables and pictures,
    :mod:`hybrid.views`, into ``views``: imports point down only.
    """

    views: ClassVar[Callable[[], Any]]

    def _repr_html_(self) -> str:
        return str(Shown.views().html(self))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the result.

        Args:
            ax: Axes to draw into; those of a new figure by default.

        Returns:
            The axes; ``plot().figure`` is the figure.
        """
        return Shown.views().plot(self, ax)  # type: ignore[no-any-return]

    def to_html(self, path: str | Path) -> None:
        """Write a page that opens offline.

        Args:
            path: HTML file; it appears whole or not at all.
        """
        Shown.views().write_page(self, path)

    def to_frame(self) -> Any:
        """The result as a pandas data frame, one row for each unknown or joint.

        Raises:
            HybridError: pandas is not installed.
        """
        check_extra("pandas", "frames", "A data frame")
        import pandas

        return pandas.DataFrame(Shown.views().rows(self))
