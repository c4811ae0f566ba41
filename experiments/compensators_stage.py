"""Which learner suits the third stage, and what holds on loads and speeds unseen?

A table appears: learners of what three stages leave of the simulated COMAN-like arm
with effects that they do not know (hose, coupled wrist, tilted base), each offered
the same joints and inputs and kept where it helps on every fold. Error with it over
error without, on motions like those learned from, with a known payload, and at higher
speed; rise of the log-likelihood of a sample on the first and on the last over that
of a Gaussian of constant size; share of samples in the 90 % interval; joints that kept
one; seconds. Medians over seeds.

    python experiments/compensators_stage.py --seeds 3
"""

from __future__ import annotations

import argparse

import numpy as np
from coman import ROOT
from compensator_stage import COLUMNS, LEARNERS, measure
from rich.console import Console

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, numbers_table, provenance
from hybrid.report import write_results as write

REPORT = ROOT / "reports" / "compensators"


def main() -> None:
    """Measure all seeds, print the table, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    count, console, found = parser.parse_args().seeds, Console(width=120), []
    command = f"python experiments/compensators_stage.py --seeds {count}"
    for seed in range(count):
        found.append(measure(seed))
        console.print(np.round(found[-1], 3).tolist())
    middle = np.nanmedian(found, axis=0)
    rows = tuple(
        (name, *(f"{x:.3g}" for x in row))
        for name, row in zip(LEARNERS, middle, strict=True)
    )
    caption = f"Medians over {count} seeds; error with a learner over that without"
    table = Table(("", *COLUMNS), rows, caption)
    console.print(numbers_table(table))
    content = {"provenance": provenance(command=command), "columns": COLUMNS}
    write(REPORT / "stage.json", {**content, "values": found, "names": [*LEARNERS]})
    with atomic_path(REPORT / "stage.md") as path:
        path.write_text(f"{caption}.\n\n{markdown_table(table)}\n    {command}\n")


if __name__ == "__main__":
    main()
