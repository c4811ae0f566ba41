"""Tables of results, as text for a page, a terminal or Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table as RichTable
from rich.text import Text

from hybrid.arrays import Array
from hybrid.identification import Validation
from hybrid.identification.validation import fair_bar
from hybrid.names import markdown
from hybrid.shown import decimals_of


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column holds names, the others usually numbers.

    Attributes:
        header: Column titles.
        rows: Cells of each row, one per column.
        caption: Meaning and unit of the numbers.
        words: Whether cells hold words, which are aligned left and wrapped.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: bool = False

    def filled(self) -> Self:
        """The table without its empty columns."""
        kept = [
            k for k, column in enumerate(zip(*self.rows, strict=True)) if any(column)
        ]
        header, *rows = (
            tuple(row[k] for k in kept) for row in (self.header, *self.rows)
        )
        return replace(self, header=header, rows=tuple(rows))


def table_from_validation(validation: Validation) -> Table:
    """RMS torque error [N·m] of every stage, with the noise floor if it is known."""
    return error_table(
        {row.name: row.rms for row in validation.rows},
        validation.joints,
        validation.units,
        f"RMS torque error on {validation.robot}, "
        f"{validation.samples:,} samples over {validation.seconds:.0f} s",
        noise_floor=validation.noise_floor,
    )


def error_table(
    rms: Mapping[str, Array],
    joints: Sequence[str],
    units: Sequence[str],
    caption: str,
    *,
    noise_floor: Array | None = None,
) -> Table:
    """Errors of models: at each joint, their mean, and its change from the fair bar.

    Args:
        rms: RMS torque error of each model by name, shape (n,), [N·m].
        joints: Joint names, length n.
        units: Units of their torques, length n.
        caption: Meaning of the numbers.
        noise_floor: RMS noise, which no model removes, shape (n,), [N·m].
    """
    rows = dict(rms) if noise_floor is None else {**rms, "noise floor": noise_floor}
    names = list(rows)
    values = np.array([[*x, np.nanmean(x)] for x in rows.values()])  # (rows, n + 1)
    bar = fair_bar(rms)
    least = values[names.index(bar), -1]
    columns = [_cells(column) for column in values.T]
    change = [_change(mean, least) for mean in values[:, -1]]
    change[names.index(bar)] = "–"
    if noise_floor is not None:
        change[-1] = ""  # it is no model
    unit = shared_unit(units)
    pairs = zip(joints, units, strict=True)
    titles = (joint if own == unit else f"{joint}, {own}" for joint, own in pairs)
    return Table(
        header=("", *titles, "mean", f"vs {bar}"),
        rows=tuple(zip(names, *columns, change, strict=True)),
        caption=f"{caption}, {unit}",
    )


def shared_unit(units: Sequence[str]) -> str:
    """Unit of the mean over joints: that of revolute ones, unless all slide."""
    return units[0] if len(set(units)) == 1 else "N·m"


def terminal_table(table: Table) -> RichTable:
    """A table for a terminal: only a last column of words folds.

    Rows of numbers with an empty last cell are dim.
    """
    rich = RichTable(
        box=SIMPLE_HEAD,
        title=Text(table.caption) if table.caption else None,
        title_justify="left",
        title_style="bold",
        pad_edge=False,
    )
    for k, title in enumerate(table.header):
        rich.add_column(
            Text(title),
            justify="right" if k and not table.words else "left",
            no_wrap=not table.words or k < len(table.header) - 1,
            style="bold" if title == "mean" else None,
        )
    for row in table.rows:
        is_model = table.words or bool(row[-1])
        # As Text, where brackets in a joint's name are no markup.
        rich.add_row(*map(Text, row), style=None if is_model else "dim")
    return rich


def markdown_table(table: Table) -> str:
    """A table as Markdown, its first column aligned left; without the caption."""
    rule = ["---", *["---:"] * (len(table.header) - 1)]
    lines = [table.header, rule, *table.rows]
    rows = ["| " + " | ".join(map(markdown, line)) + " |" for line in lines]
    return "\n".join(rows) + "\n"


def _cells(column: Array) -> list[str]:
    """Numbers with decimals for three digits of the smallest."""
    sizes = np.abs(column[np.isfinite(column) & (column != 0)])
    smallest = float(np.min(sizes, initial=np.inf))
    decimals = decimals_of(smallest, 3, most=4) if np.isfinite(smallest) else 2
    return [f"{x:.{decimals}f}" if np.isfinite(x) else "–" for x in column]


def _change(mean: float, first: float) -> str:
    percent = 100 * (mean / first - 1) if first > 0 else 0.0
    if abs(percent) < 0.05:
        return "±0 %"
    return f"{percent:+.1f} %".replace("-", "−")
