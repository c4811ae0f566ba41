"""The verb ``fleet``: which arms change, when and in which parameter, and outliers."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.fleets.changes import MONTH, threshold
from hybrid.fleets.plan import Plan, read_plan
from hybrid.fleets.run import connected
from hybrid.fleets.scatter import Scatter, calibrated_std, moderated
from hybrid.fleets.series import Series, State
from hybrid.fleets.store import Store, run_plan, write_rows
from hybrid.fleets.worker import FINDING, OK, VERDICT
from hybrid.progress import Progress, silent
from hybrid.threads import cores


@dataclass(frozen=True)
class Fleet:
    """The result for a fleet.

    Attributes:
        rows: Rows of all units.
        states: Every parameter of every arm.
        shared: Changes of all arms together, in words.
        arm_months: Sum of the monitored months of all arms.
        false_alarms: Expected false alarms in 100 arm-months.
    """

    rows: Sequence[Mapping[str, Any]]
    states: tuple[State, ...]
    shared: tuple[str, ...]
    arm_months: float
    false_alarms: float

    @property
    def alarms(self) -> list[State]:
        """Parameters that changed, highest score first."""
        found = [x for x in self.states if x.changes]
        return sorted(found, key=lambda x: -x.score)

    @property
    def refused(self) -> list[Mapping[str, Any]]:
        """Units without a result, each with its reason."""
        return [x for x in self.rows if x["status"] in ("refused", "late", "lost")]

    @property
    def diagnoses(self) -> Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]:
        """Row of the verdict, then rows of the findings, by arm and period."""
        found = defaultdict(list)
        for x in sorted(self.rows, key=lambda x: x["status"] == FINDING):
            if x["status"] in (VERDICT, FINDING):
                found[x["arm"], x["period"]].append(x)
        return found


@typed
def fleet(
    plan: Plan | str | Path,
    out: str | Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Fleet:
    """Inspect, identify and compare all arms of a plan over time.

    Args:
        plan: The plan, or its file.
        out: Folder for the results of the units and ``fleet.parquet``; units whose
            result is there are not computed again.
        scheduler: Address of a Dask scheduler; this machine's cores by default.
        workers: Processes on this machine; one per core by default.
        progress: Called with a message after each unit.

    Raises:
        HybridError: The plan is not valid, or Dask is missing.
    """
    plan = plan if isinstance(plan, Plan) else read_plan(plan)
    out = Path(out)
    with connected(scheduler, workers or cores()) as client:
        store = Store(out / "units")
        rows = run_plan(plan, store, client, progress or silent)
    write_rows(out / "fleet.parquet", rows)
    return fleet_from_rows(plan, rows)


def fleet_from_rows(plan: Plan, rows: Sequence[Mapping[str, Any]]) -> Fleet:
    """The changes and outliers of a fleet from the rows of all units."""
    groups = {arm.name: arm.group for arm in plan.arms}
    limits = {arm.name: arm.limits for arm in plan.arms}
    tables: dict[str, dict[tuple[str, str], list[Mapping[str, Any]]]] = {}
    spans: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        if row["status"] == OK:
            table = tables.setdefault(groups[row["arm"]], defaultdict(list))
            table[row["joint"], row["parameter"]].append(row)
            spans[row["arm"]].add(row["period"])
    months = sum(map(len, spans.values())) * plan.days / MONTH
    states: list[State] = []
    shared: list[str] = []
    if tables and not any(np.isfinite(x["temperature"] or np.nan) for x in rows):
        shared.append("no log has a temperature: season and ageing are confounded")

    for group, table in sorted(tables.items()):
        own = [Series(x) for _, x in sorted(table.items())]
        for series in own:
            series.remove_common()
        calibrated = calibrated_std([(x.y, x.s) for x in own])
        for series, s in zip(own, calibrated, strict=True):
            series.s = s
        scatters = moderated([Scatter.of(x.y, x.s) for x in own])
        for series, scatter in zip(own, scatters, strict=True):
            series.s = series.s * np.sqrt(scatter.square)[:, None]
            count = len(series.days)
            limit = threshold(count, plan.days, len(own), plan.false_alarms)
            states += series.states(group, scatter.freedom, limit, limits)
            shared += series.shared(limit)
    return Fleet(rows, tuple(states), tuple(shared), months, plan.false_alarms)
