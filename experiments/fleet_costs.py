"""What the units of a fleet cost, and a plan for ten thousand arms made of that.

Processor time of children and of the process that hands out the work: a wall clock
tells nothing of a machine that others use. Everything is counted by further units, so
that what is loaded once counts by itself. The efficiency at two workers is the time of
the units at one worker over that of all processes at two.
"""

from __future__ import annotations

import json
import resource
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time

from hybrid.fleets.fleet import fleet
from hybrid.fleets.plan import Plan
from hybrid.report import Table

_ARMS, _WEEKS = 10_000, 52
_WAITING = 4  # units per core that the scheduler knows of
_CORE_HOUR = 0.05  # US dollar, of a shared cloud machine


@dataclass(frozen=True)
class Cost:
    """What some units took.

    Attributes:
        units: Number of units.
        workers: Number of children.
        children: Processor time of the children, [s].
        parent: Processor time of the process that hands out, [s].
        child_mb: Memory of the largest child, [MB].
        parent_mb: Memory of the process that hands out, [MB].
        stored: Results on the disk, [bytes].
        moved: Rows and models between the processes, without the logs, [bytes].
    """

    units: int
    workers: int
    children: float
    parent: float
    child_mb: float
    parent_mb: float
    stored: int
    moved: int

    def as_dict(self) -> dict[str, float]:
        """JSON-ready."""
        return asdict(self)


def measured(plan: Plan, arms: int, workers: int) -> Cost:
    """Run some arms of a plan in an empty folder.

    Args:
        plan: A plan.
        arms: How many of its arms.
        workers: Children.
    """
    some = replace(plan, arms=plan.arms[:arms])
    folder = Path(tempfile.mkdtemp())
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), process_time()
    try:
        found = fleet(some, folder, workers=workers)
        stored = _size(folder / "units", "*.parquet")
        # A model goes from the child that identified it to the client, and back.
        moved = len(json.dumps(found.rows)) + 2 * _size(folder / "units", "*.json")
    finally:
        shutil.rmtree(folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = resource.getrusage(resource.RUSAGE_SELF)
    return Cost(
        len({(x["arm"], x["period"]) for x in found.rows}),
        workers,
        after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        process_time() - start,
        after.ru_maxrss / 1024,
        own.ru_maxrss / 1024,
        stored,
        moved,
    )


def _size(folder: Path, pattern: str) -> int:
    return sum(x.stat().st_size for x in folder.rglob(pattern))


def further(few: Cost, many: Cost) -> tuple[float, float]:
    """Processor time of a further unit in a child and in the parent, [s]."""
    count = many.units - few.units
    return (many.children - few.children) / count, (many.parent - few.parent) / count


def efficiency(one: Sequence[Cost], two: Sequence[Cost]) -> float:
    """Time of a unit at one worker over that of all processes at two.

    Args:
        one: Few and many units at one worker.
        two: The same at two workers.
    """
    return further(*one)[0] / sum(further(*two))


def measured_costs(plan: Plan, few: int, many: int) -> tuple[list[Cost], list[Cost]]:
    """Few and many arms at one worker, and the same at two."""
    one, two = ([measured(plan, x, w) for x in (few, many)] for w in (1, 2))
    return one, two


def costs(one: Sequence[Cost], two: Sequence[Cost], log_bytes: float) -> list[Table]:
    """Cost of a unit from two numbers of arms, and a plan for ten thousand arms.

    Args:
        one: Few and many units at one worker.
        two: The same at two workers.
        log_bytes: Size of the logs of a unit.
    """
    few, many = one
    unit, overhead = further(few, many)
    loading = max(0.0, many.children - unit * many.units)
    rows = (
        ("processor time of a unit, with its baseline", f"{1e3 * unit:.0f} ms"),
        ("units per hour and core", f"{3600 / unit:,.0f}"),
        ("overhead of a unit where the work is handed out", f"{1e3 * overhead:.1f} ms"),
        ("efficiency at two workers", f"{efficiency(one, two):.2f}"),
        ("loading of a child, once", f"{loading:.1f} s"),
        ("memory of a child, at the most", f"{many.child_mb:.0f} MB"),
        ("memory of client, scheduler and analysis", f"{many.parent_mb:.0f} MB"),
        ("size of its logs, of its rows", f"{log_bytes / 1e3:.0f} kB, "
         f"{many.stored / many.units / 1e3:.1f} kB"),
    )  # fmt: skip
    measured_on = f"{many.units - few.units:,} units more, processor time"
    return [
        Table(("cost", ""), rows, f"Cost, from {measured_on}"),
        _large_fleet(unit, overhead, many, log_bytes),
    ]


def _large_fleet(unit: float, overhead: float, many: Cost, log_bytes: float) -> Table:
    """What the same units cost for ten thousand arms; times in [s]."""
    whole = _ARMS * _WEEKS
    hours = whole * unit / 3600
    parent, each = whole * overhead / 3600, whole / many.units / 1e9
    rows = (
        ("units", f"{whole:,}"),
        ("processor time of the children", f"{hours:,.0f} h"),
        ("of the process that hands out", f"{parent:.1f} h"),
        ("cores that it keeps busy", f"{unit / overhead:,.0f}"),
        ("wall time on 64 cores, computed", f"{max(hours / 64, parent):.1f} h"),
        ("cost at 0.05 $ a core hour", f"{hours * _CORE_HOUR:,.2f} $"),
        ("bytes moved: logs that workers read", f"{whole * log_bytes / 1e9:,.0f} GB"),
        ("bytes moved: models and rows", f"{each * many.moved:,.1f} GB"),
        ("bytes stored", f"{each * many.stored:,.1f} GB"),
        ("units at the scheduler at a time, 64 cores", f"{_WAITING * 64}"),
    )
    return Table((f"{_ARMS:,} arms, {_WEEKS} weeks", ""), rows, "Computed, not run")
