"""Table of a chain of designs."""

import numpy as np

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results

MOTIONS = 3
ROWS = ("plain", "iterated", "iterated, block-weighted", "ours, one motion", "ours")


def write(folder, seeds, arms, runs):
    """The table and JSON.

    Args:
        folder: Where to write.
        seeds: Number of seeds that the command names.
        arms: Arms that it names.
        runs: By arm and seed, condition and CPU seconds of each row, shape (5, 2).
    """
    rows = []
    for name, found in runs.items():
        x = np.array(found)  # (S, 5, 2)
        for k, row in enumerate(ROWS):
            count = 1 if k in (0, 3) else MOTIONS
            spread = f"{np.median(x[:, k, 0]):.1f} ({x[:, k, 0].min():.1f}–"
            spread += f"{x[:, k, 0].max():.1f})"
            least = f"{np.median(x[:, 2, 0] / x[:, k, 0]):.2f}"
            seconds = f"{np.median(x[:, k, 1]):.1f}"
            rows.append((name, str(len(x)), row, str(count), spread, least, seconds))
    header = ("arm", "seeds", "design", "motions", "condition")
    header += ("block-weighted is so many times higher", "CPU s")
    lead = "Condition number of the whitened observation matrix, SI units: median "
    lead += "(lowest–highest); published 329 (plain), 275 (iterated), 193 (weighted)."
    command = f"python experiments/excitation_chain.py --seeds {seeds} --arms "
    command += " ".join(arms)
    table = markdown_table(Table(header, tuple(rows)))
    with atomic_path(folder / "table.md") as path:
        path.write_text(f"{lead}\n\n{table}\n\n`{command}`\n", encoding="utf-8")
    content = {"provenance": provenance(command=command), "rows": ROWS, "runs": runs}
    write_results(folder / "results.json", content)
