"""The plan of a fleet: its arms, their logs by period, and their baselines.

Paths are those of fsspec, so logs may lie on a disk or in a store such as ``s3://``.
The plan lists the logs and reads none.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any

from hybrid import __version__
from hybrid.errors import HybridError
from hybrid.extras import check_extra
from hybrid.files import checked_table, read_yaml
from hybrid.fleets.changes import MONTH
from hybrid.fleets.estimate import followed
from hybrid.names import name_fault

TRACK = ("coulomb", "viscous", "torque_gain", "torque_offset", "payload.mass")
FIRST = "first"
_DATE = re.compile(r"(?<!\d)(\d{4})-?(\d{2})-?(\d{2})(?!\d{2})")
_STAMP = ("size", "mtime", "ETag", "LastModified")  # change when a file changes
# By period: day, path and fingerprint of each log.
Logs = Mapping[str, list[tuple[str, str, str]]]
_DAYS = {"day": 1.0, "week": 7.0, "month": MONTH, "log": 1.0}
_NAMES = {"day": "%Y-%m-%d", "week": "%G-W%V", "month": "%Y-%m"}


@dataclass(frozen=True)
class ArmPlan:
    """One arm of a plan; the defaults of all arms stand at the top of the file.

    Attributes:
        name: Name of the arm.
        logs: Folder or glob, or a mapping from dates to files.
        robot: Robot file, or a name of a library.
        baseline: ``first``, a period, or a file of a model.
        payload: Parameters of a known payload, mass first.
        tool: Position of a payload in the last joint's frame, [m].
        limits: Largest change of a parameter, in its unit or in ``%`` of the baseline.
        group: Arms of one group are compared with each other.
        joints: Joints of the arm; the longest chain of the file if empty.
        map: How columns of the logs are named, see ``--map``.
    """

    name: str
    logs: Any
    robot: str
    baseline: str = FIRST
    payload: tuple[float, ...] = ()
    tool: tuple[float, ...] = ()
    limits: Mapping[str, str | float] = field(default_factory=dict)
    group: str = ""
    joints: tuple[str, ...] = ()
    map: str | None = None


@dataclass(frozen=True)
class Plan:
    """The plan of a fleet.

    Attributes:
        arms: The arms, sorted by name.
        track: Tracked parameters.
        period: ``day``, ``week``, ``month`` or ``log``: logs that are fitted together.
        time_limit: Longest time for one unit, [s].
        false_alarms: Expected false alarms in 100 months of an arm.
        diagnose: Whether each period is diagnosed as well, which takes minutes each.
    """

    arms: tuple[ArmPlan, ...]
    track: Sequence[str] = TRACK
    period: str = "week"
    time_limit: float = 600.0
    false_alarms: float = 1.0
    diagnose: bool = False

    @property
    def days(self) -> float:
        """Length of a period, [d]."""
        return _DAYS[self.period]


@dataclass(frozen=True)
class Unit:
    """The work that one worker does at a time: one task on the logs of one period.

    Attributes:
        arm: Name of the arm.
        period: Name of the period.
        day: Date of its first log, ISO; empty if unknown.
        logs: Path and fingerprint of each log.
        entry: All other inputs of the result.
    """

    arm: str
    period: str
    day: str
    logs: tuple[tuple[str, str], ...]
    entry: Mapping[str, Any]

    @cached_property
    def key(self) -> str:
        """Hash of all inputs of the result."""
        content = json.dumps([__version__, vars(self)], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:32]


def read_plan(path: str | Path, *, robot: str | Path | None = None) -> Plan:
    """Read a plan from a file, or make one from a folder.

    Args:
        path: YAML file, or a folder that contains a folder of logs for each arm.
        robot: Robot of all arms, if ``path`` is a folder.

    Raises:
        HybridError: The plan is not valid.
    """
    path = Path(path)
    if path.is_dir():
        if robot is None:
            raise HybridError(f"{path}: a folder of arms needs --robot")
        content: Any = {"robot": str(Path(robot).resolve()), "arms": "."}
        folder = path
    else:
        content, folder = read_yaml(path), path.parent
    return plan_from_dict(content, folder, source=str(path))


def plan_from_dict(
    content: Any, folder: str | Path = ".", *, source: str = "plan"
) -> Plan:
    """The plan from the content of a file; paths are relative to ``folder``.

    Raises:
        HybridError: The plan is not valid.
    """
    own = set(Plan.__dataclass_fields__) - {"arms"}
    common = set(ArmPlan.__dataclass_fields__) - {"name", "logs"}
    content = checked_table(content, sorted(own | common | {"arms"}), source)
    arms, base = content.get("arms"), {k: content[k] for k in common & set(content)}
    if isinstance(arms, str):
        arms = {Path(x).name: {"logs": x} for x in _folders(_resolved(arms, folder))}
    if not isinstance(arms, Mapping) or not arms:
        raise HybridError(f"{source}: arms is {arms!r}; valid is a folder, or a table")
    found = []
    for name, entry in arms.items():
        where = f"{source}: arm {name}"
        if fault := name_fault(name):
            raise HybridError(f"{source}: an arm's {fault}")
        entry = checked_table(entry, sorted(common | {"logs"}), where)
        found.append(_arm(str(name), base | entry, folder, where))
    arms = tuple(sorted(found, key=lambda x: x.name))
    plan = Plan(arms, **{k: content[k] for k in own & set(content)})
    for name in ("time_limit", "false_alarms"):
        x = getattr(plan, name)
        if isinstance(x, bool) or not isinstance(x, int | float) or not x > 0:
            raise HybridError(f"{source}: {name} is {x!r}; valid is a number above 0")
    if plan.period not in list(_DAYS):
        raise HybridError(
            f"{source}: period is {plan.period!r}; valid are {', '.join(_DAYS)}"
        )
    if not isinstance(plan.diagnose, bool) or not isinstance(plan.track, Sequence):
        raise HybridError(f"{source}: diagnose is true or false, and track a list")
    followed(plan.track, 2)
    return plan


def _arm(name: str, entry: dict[str, Any], folder: str | Path, where: str) -> ArmPlan:
    missing = [key for key in ("robot", "logs") if key not in entry]
    if missing:
        raise HybridError(f"{where}: no {' and no '.join(missing)}")
    payload, limits = entry.get("payload", []), entry.get("limits", {})
    try:
        numbers = tuple(map(float, payload if isinstance(payload, list) else [payload]))
        tool = tuple(map(float, entry.get("tool", [])))
        for x in limits.values():
            float(str(x).removesuffix("%"))
    except (TypeError, ValueError, AttributeError) as error:
        raise HybridError(
            f"{where}: payload, tool and limits are numbers ({error})"
        ) from error
    if len(numbers) > 10 or len(tool) not in (0, 3):
        raise HybridError(
            f"{where}: payload has {len(numbers)} numbers and tool {len(tool)}; valid "
            "are up to 10, and 3 or none"
        )
    logs, robot = entry["logs"], str(entry["robot"])
    if "." in robot:
        robot = _resolved(robot, folder)
        if "://" not in robot and not Path(robot).exists():
            raise HybridError(f"{where}: {robot}: no such robot file")
    baseline = str(entry.get("baseline", FIRST))
    is_file = baseline.endswith(".json")
    return ArmPlan(
        name,
        logs if isinstance(logs, Mapping) else _resolved(str(logs), folder),
        robot,
        _resolved(baseline, folder) if is_file else baseline,
        numbers,
        tool,
        limits,
        str(entry.get("group", Path(robot).name)),
        tuple(entry.get("joints", ())),
        entry.get("map"),
    )


def _resolved(path: str, folder: str | Path) -> str:
    """An absolute path or URL; a relative path starts at the folder."""
    return path if "://" in path else str(Path(folder).resolve() / path)


def _folders(path: str) -> list[str]:
    fs, root = opened(path)
    if not fs.isdir(root):
        raise HybridError(f"{path}: no such folder of arms")
    found = [_full_path(fs, x) for x in fs.ls(root, detail=False) if fs.isdir(x)]
    if not found:
        raise HybridError(
            f"{path}: valid is a folder with a folder of logs for each arm"
        )
    return sorted(found)


def periods(arm: ArmPlan, period: str) -> Logs:
    """Day, path and fingerprint of the logs of an arm by period, in order of time.

    Raises:
        HybridError: The arm has no log, or one without a date.
    """
    found: dict[str, list[tuple[str, str, str]]] = {}
    for path, stamp, stated in sorted(_logs(arm)):
        day = _day(stated or path)
        if day is None and period != "log":
            raise HybridError(
                f"arm {arm.name}: {path} has no date in its name; valid is one as "
                "2026-01-31, a table of dates and files, or 'period: log'"
            )
        if day is None or period == "log":
            name = Path(path).name
        else:
            name = day.strftime(_NAMES[period])
        found.setdefault(name, []).append((day.isoformat() if day else "", path, stamp))
    if not found:
        raise HybridError(f"arm {arm.name}: no log in {arm.logs}")
    return dict(sorted(found.items(), key=lambda x: (min(x[1])[0], x[0])))


def _logs(arm: ArmPlan) -> Iterator[tuple[str, str, str]]:
    """Path, fingerprint and stated date of every log of an arm."""
    if isinstance(arm.logs, Mapping):
        for day, path in arm.logs.items():
            fs, root = opened(str(path))
            yield str(path), _fingerprint(fs, root), str(day)
        return
    fs, root = opened(arm.logs)
    inside = fs.ls(root, detail=False) if fs.isdir(root) else fs.glob(root)
    for path in inside:
        if not Path(path).name.startswith("."):
            yield _full_path(fs, path), _fingerprint(fs, path), ""


def _fingerprint(fs: Any, path: str) -> str:
    """A hash that changes when the log changes."""
    if not fs.exists(path):
        raise HybridError(f"{path}: no such log")
    files = fs.find(path, detail=True) if fs.isdir(path) else {path: fs.info(path)}
    kept = [[str(x.get(key)) for key in _STAMP] for _, x in sorted(files.items())]
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:16]


def opened(path: str) -> tuple[Any, str]:
    """The fsspec file system of a path, and the path in it.

    Raises:
        HybridError: fsspec, or a package it needs for the path, is not installed.
    """
    check_extra("fsspec", "fleet", "A fleet")
    from fsspec.core import url_to_fs

    try:
        return url_to_fs(path)  # type: ignore[no-any-return]
    except (ImportError, ValueError) as error:
        raise HybridError(f"{path}: cannot be reached ({error})") from error


def _full_path(fs: Any, path: str) -> str:
    local = "file" in (fs.protocol if isinstance(fs.protocol, tuple) else [fs.protocol])
    return path if local else str(fs.unstrip_protocol(path))


def _day(text: str) -> date | None:
    """The last date in a path."""
    for year, month, day in reversed(_DATE.findall(text)):
        try:
            return date(int(year), int(month), int(day))
        except ValueError:
            continue
    return None
