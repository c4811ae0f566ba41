"""Measures of methods over runs: medians, ranges and ratios, and a figure."""

import numpy as np
from measures import measures_figure, measures_table

METHODS, UNITS = ("plain", "full"), {"error": "N·m"}
VALUES = {"error": np.array([[2.0, 1.0], [4.0, 1.0], [6.0, 3.0]])}


def test_a_table_gives_median_range_and_the_median_of_the_ratios():
    table = measures_table(METHODS, VALUES, UNITS)
    assert table.rows[0] == ("plain", "4", "2–6", "1.00")
    assert table.rows[1] == ("full", "1", "1–3", "0.50")
    assert table.header[1] == "error [N·m]"


def test_a_figure_shows_every_run_and_the_median():
    (axes,) = measures_figure(METHODS, VALUES, UNITS).axes
    *runs, median = axes.lines
    assert len(runs) == 3
    np.testing.assert_array_equal(median.get_ydata(), [4.0, 1.0])
