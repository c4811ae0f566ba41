"""Results as pages, figures, tables and JSON. Nothing here prints."""

from hybrid.report.figures import (
    friction_figure,
    rms_figure,
    torque_figure,
)
from hybrid.report.intervals import parameter_figure
from hybrid.report.output import figure_bytes, save_figure, write_results
from hybrid.report.page import Section, render_page, write_page
from hybrid.report.provenance import provenance
from hybrid.report.table import (
    Table,
    markdown_table,
    numbers_table,
    table_from_validation,
    validation_markdown,
    validation_table,
)

__all__ = [
    "Section",
    "Table",
    "figure_bytes",
    "friction_figure",
    "markdown_table",
    "numbers_table",
    "parameter_figure",
    "provenance",
    "render_page",
    "rms_figure",
    "save_figure",
    "table_from_validation",
    "torque_figure",
    "validation_markdown",
    "validation_table",
    "write_page",
    "write_results",
]
