"""How often online methods change their mind, and how far their runs lie apart.

The publication's Table 5 has the same two numbers. Nothing here prints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from space_robot import NAMES
from space_robot_searches import Run

from hybrid.report.table import Table

_KNOWN = 1e-20  # variance below which a parameter was given

Runs = Mapping[str, Sequence[Run]]


def variances_table(each: Mapping[str, Runs]) -> Table:
    """Updates and variances of every method.

    Args:
        each: Runs by method, by what the data are like.
    """
    rows = [
        (f"{name}, {data}", *_cells(runs))
        for data, methods in each.items()
        for name, runs in methods.items()
    ]
    count = max(len(runs) for methods in each.values() for runs in methods.values())
    caption = (
        "Updates: recursions (of a swarm at once: iterations) that ended with other "
        f"parameters than they began with, median; variance over {count} runs"
    )
    return Table(("", "updates", *(f"var {x}" for x in NAMES)), tuple(rows), caption)


def _cells(runs: Sequence[Run]) -> list[str]:
    updates = f"{np.median([run.updates for run in runs]):.0f}"
    steps = len(runs[0].path) - 1
    if len(runs) == 1:
        return [f"{updates} of {steps}", *[""] * len(NAMES)]
    spread = np.var([run.path[-1] for run in runs], axis=0, ddof=1)
    return [
        f"{updates} of {steps}",
        *("" if np.isnan(x) else f"{x:.1e}" if x > _KNOWN else "0" for x in spread),
    ]
