"""Results as pages, figures, tables and JSON. Nothing here prints."""

from hybrid.report.output import Section as Section
from hybrid.report.output import provenance as provenance
from hybrid.report.output import save_figure as save_figure
from hybrid.report.output import write_page as write_page
from hybrid.report.output import write_results as write_results
from hybrid.report.table import Table as Table
from hybrid.report.table import markdown_table as markdown_table
from hybrid.report.table import table_from_validation as table_from_validation
from hybrid.report.table import terminal_table as terminal_table
