"""Table of designed motions against random ones."""

import numpy as np
from outputs import write_tables

from hybrid.report import Table, markdown_table

FITS = ("plain least squares", "weighted", "with friction")


def write(folder, options, runs):
    """The tables and JSON.

    Args:
        folder: Where to write.
        options: First seed, number of seeds, arms and cut-off that the command names.
        runs: By arm and seed, error of all fits [N·m] and CPU seconds of the random
            and of the designed motion, and of the pooled fit, shape (3, 4).
    """
    rows, each = [], []
    for name, found in runs.items():
        x = np.array(found, dtype=float)  # (S, 3, 4)
        for k, fit in enumerate(FITS):
            random, ours = x[:, 0, k], x[:, 1, k]
            lower = 100 * (1 - ours / random)
            gain = f"{np.median(lower):.0f} ({lower.min():.0f}…{lower.max():.0f})"
            wins = f"{(ours < random).sum()} of {len(x)}"
            seconds = f"{np.median(x[:, 1, -1]):.1f}"
            rows.append((name, fit, spread(random), spread(ours), gain, wins, seconds))
        above = 100 * (x[:, :2, 0] / x[:, 2, :1] - 1)
        for k, excess in enumerate(above.T):
            values = " · ".join(f"{e:.1f}" for e in excess)
            motion = ("random", "designed")[k]
            each.append((name, motion, f"{np.median(excess):.1f}", values))
    header = ("arm", "fit", "random [N·m]", "designed [N·m]", "lower by [%]")
    table = markdown_table(Table((*header, "designed wins", "design [CPU s]"), rows))
    lead = "RMS torque error on eight random motions that neither knows, of a plant "
    lead += "without noise, mean of the joints: median of the seeds (lowest–highest)."
    seen = "Error of plain least squares above that of those which have seen the eight "
    seen += "motions themselves. It may be negative, as these minimise their squares "
    seen += "below their cut-off, and not the RMS of moving samples."
    header = ("arm", "motion", "median [%]", f"each seed from {options.first} [%]")
    pooled = markdown_table(Table(header, each))
    command = f"python experiments/designed_against_random.py --first {options.first}"
    command += f" --seeds {options.seeds} --arms {' '.join(options.arms)}"
    command += f" --cutoff {options.cutoff:g}" if options.cutoff else ""
    text = f"{lead}\n\n{table}\n\n{seen}\n\n{pooled}"
    write_tables(folder, text, command, runs=runs)


def spread(x):
    """Median, lowest and highest."""
    return f"{np.median(x):.3f} ({x.min():.3f}–{x.max():.3f})"
