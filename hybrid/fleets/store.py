"""Stored results: every unit is computed once; a rerun computes only missing ones."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.errors import HybridError
from hybrid.files import atomic_path, read_json, write_json
from hybrid.fleets.plan import FIRST, ArmPlan, Logs, Plan, Unit, opened, periods
from hybrid.fleets.run import answers
from hybrid.fleets.worker import FINDING, LATE, LOST, REFUSED, VERDICT
from hybrid.progress import Progress
from hybrid.shown import plain

if TYPE_CHECKING:
    from distributed import Client


_TEXT = ("arm", "period", "day", "joint", "parameter", "unit", "status", "reason")
_NUMBERS = (
    "change", "std", "baseline", "baseline_std", "temperature", "load", "residual",
)  # fmt: skip
_CANDIDATES = 4  # first periods, of which one becomes the baseline


@dataclass(frozen=True)
class _Baseline:
    key: str
    text: str | None  # of the model; None if there is none
    reason: str


class Store:
    """Results of units in a folder, each a file named by the hash of its inputs."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> Any:
        """Stored content; None if there is no file, or a damaged one."""
        try:
            return read_json(self._path(key))
        except (OSError, ValueError):
            return None

    def put(self, key: str, content: Any) -> None:
        """Store content in one step."""
        write_json(self._path(key), content)

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as Parquet in one step; the same rows give the same bytes."""
    import pyarrow as pa
    from pyarrow.parquet import write_table

    kinds = dict.fromkeys(_TEXT, pa.string()) | dict.fromkeys(_NUMBERS, pa.float64())
    table = pa.Table.from_pylist(list(rows), schema=pa.schema(kinds.items()))
    with atomic_path(path) as temporary:
        write_table(table, temporary)


def run_plan(
    plan: Plan, store: Store, client: Client, progress: Progress
) -> list[dict[str, Any]]:
    """Rows of all units of a plan, sorted; stored units are not computed again.

    Raises:
        HybridError: A log has no date, or a baseline is missing.
    """
    found, todo = [], []
    for unit, baseline in _units(plan, store, client, progress):
        rows = store.get(unit.key) or store.get(_late_unit(unit, plan).key)
        if baseline.text is None:
            rows = _failed(unit, REFUSED, baseline.reason)
        if rows is None:
            todo.append((unit, _message(unit), baseline.text))
        else:
            found += rows
    for unit, content in _answered(client, todo, plan, progress, "periods"):
        failed = content.get("failed", "")
        rows = (
            _failed(unit, failed, content["reason"])
            if failed
            else _labelled(unit, content["rows"])
        )
        if failed != LOST:  # a lost worker is no property of the logs
            store.put((_late_unit(unit, plan) if failed == LATE else unit).key, rows)
        found += rows
    return sorted(found, key=lambda x: [str(x[name] or "") for name in _TEXT])


def _answered(
    client: Client, todo: list[Any], plan: Plan, progress: Progress, what: str
) -> Iterator[tuple[Unit, dict[str, Any]]]:
    """Units and their answers as they arrive."""
    answered = answers(client, iter(todo), plan.time_limit)
    for done, (unit, content) in enumerate(answered, 1):
        progress(f"{done:,} of {len(todo):,} {what}", done / len(todo))
        yield unit, content


def _late_unit(unit: Unit, plan: Plan) -> Unit:
    """The unit under which a timeout is stored, so that a longer limit tries again."""
    return replace(unit, entry={**unit.entry, "late": plan.time_limit})


def _failed(unit: Unit, failed: str, reason: str) -> list[dict[str, Any]]:
    """Rows of a unit without a result; of a diagnosis, a verdict and its reason."""
    rows = [(failed, reason)]
    if unit.entry["task"] == "diagnosis":
        rows = [(VERDICT, failed), (FINDING, reason)]
    return _labelled(unit, [{"status": x, "reason": y} for x, y in rows])


def _labelled(unit: Unit, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    own = {"arm": unit.arm, "period": unit.period, "day": unit.day}
    every = dict.fromkeys((*_TEXT, *_NUMBERS))
    return [plain({**every, **row, **own}) for row in rows]


def _message(unit: Unit) -> dict[str, Any]:
    entry = {k: x for k, x in unit.entry.items() if k != "baseline"}
    return {"logs": [path for path, _ in unit.logs], **entry}


def _units(
    plan: Plan, store: Store, client: Client, progress: Progress
) -> Iterator[tuple[Unit, _Baseline]]:
    """All units with their baselines."""
    logs = {arm.name: periods(arm, plan.period) for arm in plan.arms}
    known = _baselines(plan, logs, store, client, progress)
    for arm in plan.arms:
        # A baseline from the arm's own logs contains its payload.
        payload = arm.payload if arm.baseline.endswith(".json") else ()
        baseline = known[arm.name]
        common = {"baseline": baseline.key, "payload": list(payload), "map": arm.map}
        tasks: list[dict[str, Any]] = [
            {"task": "period", "track": list(plan.track), "tool": list(arm.tool)}
        ]
        if plan.diagnose:
            tasks.append({"task": "diagnosis"})
        for period, own in logs[arm.name].items():
            states = tuple((path, state) for _, path, state in own)
            for task in tasks:
                entry = common | task
                yield Unit(arm.name, period, min(own)[0], states, entry), baseline


def _baselines(
    plan: Plan,
    logs: Mapping[str, Logs],
    store: Store,
    client: Client,
    progress: Progress,
) -> dict[str, _Baseline]:
    """The baseline of every arm; identified if it is no file."""
    found: dict[str, _Baseline] = {}
    todo = []
    for arm in plan.arms:
        if arm.baseline.endswith(".json"):
            text = _read_text(arm.baseline)
            key = Unit(arm.baseline, "", "", (), {"text": text}).key
            found[arm.name] = _Baseline(key, text, "")
            continue
        unit, message = _baseline_unit(arm, logs[arm.name])
        content = store.get(unit.key)
        if content is None:
            todo.append((unit, message, None))
        else:
            found[arm.name] = _baseline_from(unit.key, content)
    for unit, content in _answered(client, todo, plan, progress, "baselines"):
        if "failed" not in content:
            store.put(unit.key, content)
        found[unit.arm] = _baseline_from(unit.key, content)
    return found


def _baseline_from(key: str, content: Mapping[str, Any]) -> _Baseline:
    model = content.get("model")
    text = None if model is None else json.dumps(model)
    return _Baseline(key, text, f"no baseline: {content.get('reason', '')}")


def _baseline_unit(arm: ArmPlan, logs: Logs) -> tuple[Unit, dict[str, Any]]:
    """Unit and message of the baseline, with its candidate periods."""
    if arm.baseline != FIRST and arm.baseline not in logs:
        raise HybridError(
            f"arm {arm.name}: baseline is {arm.baseline!r}; valid are {FIRST!r}, a "
            f"model's .json, or a period as {next(iter(logs))}"
        )
    names = list(logs)[:_CANDIDATES] if arm.baseline == FIRST else [arm.baseline]
    message = {
        "task": "baseline",
        "robot": arm.robot,
        "joints": list(arm.joints),
        "map": arm.map,
        "periods": [[name, [path for _, path, _ in logs[name]]] for name in names],
    }
    states = tuple((path, state) for x in names for _, path, state in logs[x])
    return Unit(arm.name, arm.baseline, "", states, message), message


def _read_text(path: str) -> str:
    fs, root = opened(path)
    try:
        return str(fs.read_text(root, encoding="utf-8"))
    except OSError as error:
        raise HybridError(f"{path}: no readable baseline ({error})") from error
