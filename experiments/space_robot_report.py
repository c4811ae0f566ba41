"""Report of ``space_robot_online.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from outputs import captioned, write_tables
from rich.console import Console
from space_robot import NAMES, SAMPLES, TRUE
from space_robot_searches import Run
from space_robot_variances import variances_table

from hybrid.arrays import Array
from hybrid.report import save_figure, terminal_table
from hybrid.report.style import BLUE, GREY, OTHERS, RED, clean, legend, new_figure
from hybrid.report.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PUBLISHED = {
    "published recursive DE, best": (
        *(6.7255, 3.3889, 2.9918, 0.0),
        *(2.8384, 3.1698, 0.0719, 0.2053),
    ),
    "published least squares": (6.7370, 3.4202, 3.0092, 0.4917),
    "published genetic": (6.08, 3.07, 2.72),
    "published swarm": (6.7335, 3.4001, 3.0001),
}
INKS = (GREY, "black", RED, BLUE, OTHERS[0])  # recursive DE in four variants, the swarm
SECONDS = {"published recursive DE, best": 4.0}  # of one recursion


def _row(name: str, x: Array, seconds: float | None = None) -> tuple[str, ...]:
    values = np.append(x, np.full(8 - len(x), np.nan))
    cells = ["" if np.isnan(y) else f"{y:.4f}" for y in values]
    error = np.abs(values[:3] - TRUE[:3]).mean()
    return name, *cells, f"{error:.2g}", "" if seconds is None else f"{seconds:.2g}"


def _rows(name: str, runs: Sequence[Run]) -> list[tuple[str, ...]]:
    """Median, quartiles, and the run that fits best."""
    points = np.array([run.path[-1] for run in runs])
    seconds = float(np.median([run.seconds for run in runs]))
    first = _row(name, np.median(points, axis=0), seconds)
    if len(points) == 1:
        return [first]
    error = np.median(np.abs(points - TRUE)[:, :3].mean(axis=1))
    ends = zip(*np.percentile(points, [25, 75], axis=0), strict=True)
    quartiles = ("" if np.isnan(a) else f"{a:.4g} to {b:.4g}" for a, b in ends)
    best = points[int(np.argmin([run.cost for run in runs]))]
    return [
        (*first[:-2], f"{error:.2g}", first[-1]),
        ("  quartiles", *quartiles, "", ""),
        _row("  best fit of all runs", best),
    ]


def _figure(runs: dict[str, list[Run]]) -> Figure:
    """Way of the searches to the truth."""
    figure = new_figure(height=2.6)
    axes = figure.subplots()
    clean(axes, grid="both")
    for (name, each), ink in zip(runs.items(), INKS, strict=False):
        error = [np.abs(run.path[:, :3] - TRUE[:3]).mean(axis=1) for run in each]
        label = name.removeprefix("recursive ")
        axes.semilogy(np.median(error, axis=0), color=ink, label=label)
    axes.set_xlabel("recursion")
    axes.set_ylabel("mean |error| of α, β, ε")
    legend(figure, axes.get_legend_handles_labels()[0])
    return figure


def write_report(
    out: Path,
    runs: dict[str, dict[str, list[Run]]],
    plain: dict[str, Array],
    options: str,
) -> None:
    """Print the table and write it with the figure and the numbers."""
    rows = [_row("true", TRUE)]
    rows += [_row(k, np.array(x), SECONDS.get(k)) for k, x in PUBLISHED.items()]
    rows += [_row(name, x) for name, x in plain.items()]
    for data, methods in runs.items():
        for name, each in methods.items():
            rows += _rows(f"{name}, {data}", each)
    exact = next(iter(runs.values()))
    count = len(next(iter(exact.values())))
    caption = f"{SAMPLES} samples, 34 of them recursions; medians over {count} runs"
    header = ("", *NAMES, "mean error of α, β, ε", "seconds per sample")
    table = Table(header, tuple(rows), caption)
    tables = [table, variances_table(runs)]
    Console(width=210).print(*map(terminal_table, tables))
    command = f"python experiments/space_robot_online.py {options}"
    save_figure(_figure(exact), out / "figure.png")
    content: dict[str, object] = {"true": TRUE}
    for data, methods in runs.items():
        for name, each in methods.items():
            last = np.array([run.path[-1] for run in each])
            content[f"{name}, {data}"] = {
                "median": np.median(last, axis=0),
                "variance": np.var(last, axis=0, ddof=len(last) > 1),
                "updates": [run.updates for run in each],
                "cost": [run.cost for run in each],
            }
    write_tables(out, captioned(*tables), command, **content)
