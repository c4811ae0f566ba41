"""What the units of a fleet cost, and a plan for ten thousand arms made of that.

Processor time of children and of the process that hands out the work: a wall clock
tells nothing of a machine that others use.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
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
    """What some units took: processor seconds of children and parent, and memory."""

    units: int
    workers: int
    children: float
    parent: float
    child_mb: float
    parent_mb: float
    stored: int

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
        stored = sum(x.stat().st_size for x in (folder / "units").rglob("*.parquet"))
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
    )


def costs(few: Cost, many: Cost, log_bytes: float) -> list[Table]:
    """Cost of a unit from two numbers of arms, and a plan for ten thousand arms.

    Args:
        few: A few units at one worker.
        many: More units at one worker.
        log_bytes: Mean size of a log.
    """
    count = many.units - few.units
    unit, overhead = (
        (getattr(many, x) - getattr(few, x)) / count for x in ("children", "parent")
    )
    loading = max(0.0, many.children - unit * many.units)
    whole = _ARMS * _WEEKS
    hours = whole * unit / 3600
    rows = (
        ("processor time of a unit, with its baseline", f"{1e3 * unit:.0f} ms"),
        ("logs per hour and core", f"{3600 / unit:,.0f}"),
        ("overhead of a unit where the work is handed out", f"{1e3 * overhead:.1f} ms"),
        ("loading of a child, once", f"{loading:.1f} s"),
        ("memory of a child, at the most", f"{many.child_mb:.0f} MB"),
        ("memory of client, scheduler and analysis", f"{many.parent_mb:.0f} MB"),
        ("size of a log, of its rows", f"{log_bytes / 1e3:.0f} kB, "
         f"{many.stored / many.units / 1e3:.1f} kB"),
    )  # fmt: skip
    plan = (
        ("units", f"{whole:,}"),
        ("processor time of the children", f"{hours:,.0f} h"),
        ("of the process that hands out", f"{whole * overhead / 3600:.1f} h"),
        ("cores that it keeps busy", f"{unit / overhead:,.0f}"),
        (
            "wall time on 64 cores, computed",
            f"{max(hours / 64, whole * overhead / 3600):.1f} h",
        ),
        ("cost at 0.05 $ a core hour", f"{hours * _CORE_HOUR:,.2f} $"),
        ("bytes read", f"{whole * log_bytes / 1e9:,.0f} GB"),
        ("bytes stored", f"{whole * many.stored / many.units / 1e9:,.1f} GB"),
        ("units at the scheduler at a time, 64 cores", f"{_WAITING * 64}"),
    )
    measured_on = f"{count:,} units more at one worker, processor time"
    return [
        Table(("cost", ""), rows, f"Cost, from {measured_on}"),
        Table((f"{_ARMS:,} arms, {_WEEKS} weeks", ""), plan, "Computed, not run"),
    ]
