"""Online identification of a two-joint space robot with unknown payload and friction.

A table appears: true values, the published results, recursive differential evolution
in four variants over many runs (medians, and the median error), plain searches and
least squares, and ours, tracked sample by sample. A figure shows the way there.

    python experiments/space_robot_online.py --runs 50
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from space_robot import (
    LOWER,
    NAMES,
    SAMPLES,
    TRUE,
    UPPER,
    motion,
    predicted,
    recursive_search,
    rigid_columns,
)
from space_robot_ours import track, with_noise

from hybrid.files import atomic_path
from hybrid.report import markdown_table, numbers_table, provenance, save_figure
from hybrid.report.output import write_results
from hybrid.report.style import BLUE, GREY, RED, clean, legend, new_figure
from hybrid.report.table import Table
from hybrid.robot.chain import Array
from hybrid.search import minimise
from hybrid.search.adaptive_genetic import AdaptiveGenetic

REPORT = Path(__file__).parents[1] / "reports" / "space_robot"
PUBLISHED = {
    "published recursive DE, best": [
        6.7255,
        3.3889,
        2.9918,
        0,
        2.8384,
        3.1698,
        0.0719,
        0.2053,
    ],
    "published least squares": [6.7370, 3.4202, 3.0092, 0.4917],
    "published genetic": [6.08, 3.07, 2.72],
    "published swarm": [6.7335, 3.4001, 3.0001],
}
VARIANTS = {
    "best/2": ("best2bin", 0.0),
    "best/2, improved": ("best2bin", 0.02),
    "rand-to-best": ("randtobest1bin", 0.0),
    "rand-to-best, improved": ("randtobest1bin", 0.02),
}
NOISE = 0.01  # N·m


def plain(data: tuple[Array, ...]) -> Iterator[tuple[str, Array]]:
    """Least squares with Coulomb and viscous friction only, and a genetic search."""
    q, v, a, tau = data
    columns = np.concatenate(
        [rigid_columns(q, v, a), np.sign(v)[..., None], v[..., None]], 2
    )
    x = np.linalg.lstsq(columns.reshape(-1, 6), tau.ravel(), rcond=None)[0]
    yield "least squares, no Stribeck", np.array([*x[:5], np.nan, np.nan, x[5]])
    search = AdaptiveGenetic(LOWER, UPPER, rng=np.random.default_rng(0), population=80)
    minimise(search, lambda p: np.sum((predicted(p, q, v, a) - tau) ** 2, (1, 2)), 500)
    yield "genetic", search.best.point


def main() -> None:
    """Run everything, print the table, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=50)
    runs, data, console = parser.parse_args().runs, motion(), Console(width=150)
    found, paths, took = {}, {}, 0.0
    for name, (strategy, detour) in VARIANTS.items():
        start = time.process_time()
        each = [recursive_search(data, s, detour, strategy) for s in range(runs)]
        took = (time.process_time() - start) / runs
        paths[name] = np.array([np.abs(p[:, :3] - TRUE[:3]).mean(1) for p, _ in each])
        found[f"recursive DE, {name}"] = np.array([p[-1] for p, _ in each])
        console.print(f"{name}: {took:.2f} s a run")
    for label, noise in (("no noise", 0.0), (f"noise {NOISE} N·m", NOISE)):
        for way, offline in (("", True), (", no offline start", False)):
            many = [
                track(with_noise(data, noise, s), noise, offline=offline)
                for s in range(runs if noise else 1)
            ]
            found[f"ours, {label}{way}"] = np.array([x for x, _, _ in many])
        console.print(f"ours: {1e6 * np.median([t for *_, t in many]):.0f} µs a sample")
    rows = [("true", *(f"{x:.4f}" for x in TRUE), "")]
    single = {
        k: np.array([[*x, *[np.nan] * (8 - len(x))]]) for k, x in PUBLISHED.items()
    }
    single |= {name: x[None] for name, x in plain(data)}
    for name, points in (single | found).items():
        middle = np.median(points, axis=0)
        error = np.median(np.abs(points - TRUE), axis=0)
        cells = ["" if np.isnan(x) else f"{x:.4f}" for x in middle]
        rows.append((name, *cells, f"{np.nanmean(error[:3]):.2g}"))
        if len(points) > 1:
            rows.append(("  median |error|", *(f"{x:.2g}" for x in error), ""))
    caption = f"{SAMPLES} samples, 34 of them recursions; medians over {runs} runs"
    table = Table(("", *NAMES, "mean error of α, β, ε"), tuple(rows), caption)
    console.print(numbers_table(table))
    figure = new_figure(height=2.6)
    axes = figure.subplots()
    clean(axes, grid="both")
    for (name, path), ink in zip(
        paths.items(), (GREY, "black", RED, BLUE), strict=True
    ):
        axes.semilogy(np.median(path, axis=0), color=ink, label=name)
    axes.set_xlabel("recursion")
    axes.set_ylabel("mean |error| of α, β, ε")
    legend(figure, axes.get_legend_handles_labels()[0])
    save_figure(figure, REPORT / "figure.png")
    command = f"python experiments/space_robot_online.py --runs {runs}"
    with atomic_path(REPORT / "table.md") as path_:
        path_.write_text(f"{caption}.\n\n{markdown_table(table)}\n    {command}\n")
    content = {"provenance": provenance(command=command), "true": TRUE, "found": found}
    write_results(REPORT / "results.json", content)


if __name__ == "__main__":
    main()
