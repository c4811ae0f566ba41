"""Table of a chain of designs."""

import numpy as np
from outputs import write_tables

from hybrid.report import Table, markdown_table

MOTIONS = 3
# Name of each row, and its number of motions.
ROWS = {
    "plain": 1,
    "iterated": MOTIONS,
    "iterated, block-weighted as printed": MOTIONS,
    "iterated, block-weighted by magnitudes": MOTIONS,
    "ours": 1,
    "ours, chosen together": MOTIONS,
    "ours, B-splines of 20 free points": 1,
}


def write(folder, seeds, arms, runs):
    """The table and JSON.

    Args:
        folder: Where to write.
        seeds: Number of seeds that the command names.
        arms: Arms that it names.
        runs: By arm and seed, condition and CPU seconds of each row, shape (7, 2).
    """
    rows = []
    for name, found in runs.items():
        x = np.array(found)  # (S, 7, 2)
        for k, (row, count) in enumerate(ROWS.items()):
            spread = f"{np.median(x[:, k, 0]):.1f} ({x[:, k, 0].min():.1f}–"
            spread += f"{x[:, k, 0].max():.1f})"
            least = f"{np.median(x[:, 0, 0] / x[:, k, 0]):.2f}"
            seconds = f"{np.median(x[:, k, 1]):.1f}"
            rows.append((name, str(len(x)), row, str(count), spread, least, seconds))
    header = ("arm", "seeds", "design", "motions", "condition")
    header += ("plain is so many times higher", "CPU s")
    lead = "Condition number of the whitened observation matrix, SI units: median "
    lead += "(lowest–highest); published 329 (plain), 275 (iterated), 193 (weighted). "
    lead += "Motions of 10 s at rest at both ends, 0.8 × limits of position, speed and "
    lead += "acceleration; all but the last row are Fourier series of 5 harmonics."
    command = f"python experiments/excitation_chain.py --seeds {seeds} --arms "
    command += " ".join(arms)
    table = markdown_table(Table(header, tuple(rows)))
    text = f"{lead}\n\n{table}"
    write_tables(folder, text, command, rows=tuple(ROWS), runs=runs)
