"""What the units of a fleet cost, and a plan for ten thousand arms made of that.

Processor time of children and of the process that hands out the work: a wall clock
tells nothing of a machine that others use. Everything is counted by further units, so
that what is loaded once counts by itself. While it waits, Dask takes a share of a core,
which is measured apart and counted for the time that units take on cores of their own.
The efficiency at two workers is the time of the units at one worker over that of all
processes at two: the median of runs, each beside its own at one worker.
"""

from __future__ import annotations

import json
import resource
import shutil
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time, sleep, time

import numpy as np

from hybrid.fleets.fleet import fleet
from hybrid.fleets.plan import Plan
from hybrid.fleets.run import connected
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
        wall: Time by the clock, [s].
        child_mb: Memory of the largest child, [MB].
        parent_mb: Memory of the process that hands out, [MB].
        stored: Results on the disk, [bytes].
        rows: Rows as they come from the children, [bytes].
        model: Mean size of a baseline, [bytes].
    """

    units: int
    workers: int
    children: float
    parent: float
    wall: float
    child_mb: float
    parent_mb: float
    stored: int
    rows: int
    model: float

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
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = process_time(), time()
    try:
        found = fleet(some, folder, workers=workers)
        stored = _size(folder / "units", "*.json")
        model = _size(folder / "units", "*.json") / arms
    finally:
        shutil.rmtree(folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = resource.getrusage(resource.RUSAGE_SELF)
    return Cost(
        len({(x["arm"], x["period"]) for x in found.rows}),
        workers,
        after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        process_time() - start[0],
        time() - start[1],
        after.ru_maxrss / 1024,
        own.ru_maxrss / 1024,
        stored,
        len(json.dumps(found.rows)),
        model,
    )


def _size(folder: Path, pattern: str) -> int:
    return sum(x.stat().st_size for x in folder.rglob(pattern))


def waiting(seconds: float = 5.0) -> float:
    """Share of a core that the process takes while it waits for a unit."""
    with connected(None, 1) as client:
        client.submit(sleep, 0.1).result()
        before = process_time()
        client.submit(sleep, seconds).result()
        return (process_time() - before) / seconds


def further(few: Cost, many: Cost, share: float) -> tuple[float, float]:
    """Processor time of a further unit in a child and in the parent, [s].

    Args:
        few: A few units.
        many: More units at as many workers.
        share: Result of :func:`waiting`.
    """
    count = many.units - few.units
    unit = (many.children - few.children) / count
    handed = many.parent - few.parent - share * (many.wall - few.wall)
    return unit, handed / count + share * unit / many.workers


@dataclass(frozen=True)
class Costs:
    """What few and many units cost.

    Attributes:
        one: Few and many units at one worker, of each run.
        two: The same at two workers.
        share: Result of :func:`waiting`.
    """

    one: tuple[tuple[Cost, Cost], ...]
    two: tuple[tuple[Cost, Cost], ...]
    share: float

    @classmethod
    def measured(cls, plan: Plan, few: int, many: int, runs: int) -> Costs:
        """Measure few and many arms of a plan, some times."""
        share = waiting()  # first, since it loads Dask
        both = [
            [(measured(plan, few, w), measured(plan, many, w)) for w in (1, 2)]
            for _ in range(runs)
        ]
        one, two = zip(*both, strict=True)
        return cls(one, two, share)

    @property
    def unit(self) -> tuple[float, float]:
        """Median cost of a unit at one worker, see :func:`further`."""
        each = np.array([further(*x, self.share) for x in self.one])
        unit, overhead = np.median(each, axis=0)
        return float(unit), float(overhead)

    @property
    def efficiencies(self) -> list[float]:
        """Of each run, time of a unit at one worker over that of all at two."""
        pairs = zip(self.one, self.two, strict=True)
        return sorted(
            further(*one, self.share)[0] / sum(further(*two, self.share))
            for one, two in pairs
        )


def costs(found: Costs, log_bytes: float) -> list[Table]:
    """Cost of a unit, and a plan for ten thousand arms.

    Args:
        found: What was measured.
        log_bytes: Size of the logs of a unit.
    """
    few, many = found.one[0]
    unit, overhead = found.unit
    every = found.efficiencies
    loading = max(0.0, many.children - unit * many.units)
    rows = (
        ("processor time of a unit, with its baseline", f"{1e3 * unit:.0f} ms"),
        ("units per hour and core", f"{3600 / unit:,.0f}"),
        ("overhead of a unit where the work is handed out", f"{1e3 * overhead:.1f} ms"),
        ("– share of a core that waiting takes", f"{100 * found.share:.1f} %"),
        ("efficiency at two workers, median and range",
         f"{np.median(every):.2f} ({every[0]:.2f}–{every[-1]:.2f})"),
        ("loading of a child, once", f"{loading:.1f} s"),
        ("memory of a child, at the most", f"{many.child_mb:.0f} MB"),
        ("memory of client, scheduler and analysis", f"{many.parent_mb:.0f} MB"),
        ("size of its logs, of its rows", f"{log_bytes / 1e3:.0f} kB, "
         f"{many.stored / many.units / 1e3:.1f} kB"),
    )  # fmt: skip
    more = many.units - few.units
    measured_on = f"{more:,} units more, processor time, {len(every)} runs"
    return [
        Table(("cost", ""), rows, f"Cost, from {measured_on}"),
        _large_fleet(unit, overhead, many, log_bytes),
    ]


def _large_fleet(unit: float, overhead: float, many: Cost, log_bytes: float) -> Table:
    """What the same units cost for ten thousand arms; times in [s]."""
    whole = _ARMS * _WEEKS
    hours = whole * unit / 3600
    parent, each = whole * overhead / 3600, whole / many.units / 1e9
    # A model goes from the child that identified it to the client, and back.
    moved = each * many.rows + 2 * _ARMS * many.model / 1e9
    rows = (
        ("units", f"{whole:,}"),
        ("processor time of the children", f"{hours:,.0f} h"),
        ("of the process that hands out", f"{parent:.1f} h"),
        ("cores that it keeps busy", f"{unit / overhead:,.0f}"),
        ("wall time on 64 cores, computed", f"{max(hours / 64, parent):.1f} h"),
        ("cost at 0.05 $ a core hour", f"{hours * _CORE_HOUR:,.2f} $"),
        ("bytes moved: logs that workers read", f"{whole * log_bytes / 1e9:,.0f} GB"),
        ("bytes moved: models and rows", f"{moved:,.1f} GB"),
        ("bytes stored", f"{each * many.stored:,.1f} GB"),
        ("units at the scheduler at a time, 64 cores", f"{_WAITING * 64}"),
    )
    return Table((f"{_ARMS:,} arms, {_WEEKS} weeks", ""), rows, "Computed, not run")
