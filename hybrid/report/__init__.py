"""Results as pages, figures, tables and JSON. Nothing here prints."""

from hybrid.report.fit import torque_figure
from hybrid.report.output import (
    Section,
    figure_bytes,
    provenance,
    save_figure,
    write_page,
    write_results,
)
from hybrid.report.table import (
    Table,
    markdown_table,
    table_from_validation,
    terminal_table,
)

__all__ = [
    "Section",
    "Table",
    "figure_bytes",
    "markdown_table",
    "terminal_table",
    "provenance",
    "save_figure",
    "table_from_validation",
    "torque_figure",
    "write_page",
    "write_results",
]
