"""One case after the other: make the plant, diagnose it, open the truth, score."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import hybrid
from blind.baselines import baselines
from blind.case import Case
from blind.generate import IMPOSSIBLE
from blind.motions import motion_error
from blind.oracle import shrinkage
from blind.robots import load_arm
from blind.score import Named, covered, named_causes, score
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import effect_classes, effect_from_dict
from hybrid.errors import HybridError, HybridWarning
from hybrid.files import write_json
from hybrid.fleets.run import answers, connected
from hybrid.fleets.worker import serve
from hybrid.recording import Recording, read_all
from hybrid.robot import Robot

Row = dict[str, Any]
_LIMIT = 900.0  # s for a case, with its plant and the other methods
Causes = Mapping[str, tuple[Named, ...]]  # by method


def run_cases(
    cases: Sequence[Case],
    log: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    tell: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Rows of all cases; what the same code has answered already is not run again.

    Args:
        cases: The cases.
        log: One JSON line for each case that was run; appended to.
        workers: Number of processes on this machine.
        scheduler: Address of a Dask scheduler, whose workers have this folder on
            their ``PYTHONPATH``; this machine by default.
        tell: Called with each new row.

    Raises:
        RobotError: There is no such arm.
        HybridError: The generator failed.
    """
    for name in {case.robot for case in cases}:
        load_arm(name)
    code = code_digest()
    rows = {k: x for k, x in read_rows(log).items() if x.get("code") == code}
    wanted = [c for c in cases if c.key not in rows]
    log.parent.mkdir(parents=True, exist_ok=True)
    for answer in _rows(wanted, workers, scheduler):
        row = answer | {"code": code}
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        rows[row["key"]] = row
        if tell:
            tell(row)
    return [rows[c.key] for c in cases if c.key in rows]


def code_digest() -> str:
    """Digest of the sources that an answer depends on: the package, and this folder."""
    folders = Path(hybrid.__file__).parent, Path(__file__).parent
    digest = sha256()
    for path in sorted(p for folder in folders for p in folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def read_rows(log: Path) -> dict[str, Row]:
    """Rows of a log by the key of their case."""
    if not log.is_file():
        return {}
    lines = log.read_text(encoding="utf-8").splitlines()
    rows = []
    for line in lines:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:  # interrupted while it was written
            continue
    return {row["key"]: row for row in rows}


def _rows(cases: Sequence[Case], workers: int, scheduler: str | None) -> Iterator[Row]:
    """The answers of child processes; one that is late or lost is no answer."""
    jobs = ((case, {"case": asdict(case)}, None) for case in cases)
    os.environ.update(_environment())
    with connected(scheduler, workers) as client:
        for case, row in answers(client, jobs, _LIMIT, __name__):
            if "failed" in row:
                told = f"{row['failed']}: {row['reason']}"
                row = {"key": case.key, **asdict(case), "crashed": told}
            yield row


def run_case(case: Case) -> Row:
    """Diagnose one plant blindly and score the answer."""
    row: Row = {"key": case.key, **asdict(case), "arm": case.arm}
    with tempfile.TemporaryDirectory() as folder:
        visible, sealed = Path(folder) / "open", Path(folder) / "sealed"
        if why_not := make(case, Path(folder), visible, sealed):
            return row | {"skipped": why_not}
        with _quiet():
            try:
                answer = _answer(visible)
            except Exception as error:  # a crash is a score, too
                return row | {"crashed": f"{type(error).__name__}: {error}"}
            return row | _scored(answer, sealed)


def make(case: Case, folder: Path, visible: Path, sealed: Path) -> str:
    """Let the generator make a case, in a process that this one cannot look into.

    Returns:
        Nothing, or why no such plant can be.

    Raises:
        HybridError: The generator failed.
    """
    write_json(folder / "case.json", asdict(case))
    done = subprocess.run(
        [sys.executable, "-m", "blind.generate",
         str(folder / "case.json"), str(visible), str(sealed)],
        capture_output=True, text=True, check=False, env=_environment(),
    )  # fmt: skip
    *_, last = done.stderr.strip().splitlines() or [""]
    if done.returncode not in (0, IMPOSSIBLE):
        raise HybridError(f"the generator failed on {case.key}: {last}")
    return last if done.returncode == IMPOSSIBLE else ""


def _environment() -> dict[str, str]:
    """The environment in which a process of its own finds this folder."""
    path = os.environ.get("PYTHONPATH")
    here = str(Path(__file__).parents[1])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (here, path)))}


def read_open(visible: Path) -> tuple[Robot, list[Recording], tuple[str, ...]]:
    """What a diagnosis gets: the simulator, recordings, and effects to leave out."""
    content = json.loads((visible / "robot.json").read_text(encoding="utf-8"))
    question = json.loads((visible / "question.json").read_text(encoding="utf-8"))
    return Robot.from_dict(content), read_all([visible]), tuple(question["without"])


def _answer(visible: Path) -> tuple[Result, float, Causes]:
    """What the diagnosis says of what it may see, its time, and what others name."""
    robot, recordings, without = read_open(visible)
    start = time.process_time()
    result = examine(robot, recordings, without=without)
    seconds = time.process_time() - start
    return result, seconds, baselines(result, recordings[0])


def _scored(answer: tuple[Result, float, Causes], sealed: Path) -> Row:
    result, seconds, others = answer
    truth = json.loads((sealed / "truth.json").read_text(encoding="utf-8"))
    found = result.diagnosis.as_dict()
    kept = ("effect", "joints", "class", "share", "parameters", "shrink")
    row: Row = {
        "truth": truth,
        "cpu_s": seconds,
        **{k: found[k] for k in ("verdict", "background")},
        "unexplained": found["unknown"],
        "where": [region["joint"] for region in found["where"]],
        "findings": [{k: f[k] for k in kept} for f in found["findings"]],
        **score(truth, named_causes(found)),
        "covered": covered(truth, found["findings"]),
        "baselines": {k: score(truth, x) for k, x in others.items()},
    }
    known = effect_classes()
    if truth["effects"] and all(e["effect"] in known for e in truth["effects"]):
        joints = result.gap.robot.joints
        effects = [effect_from_dict(e, joints) for e in truth["effects"]]
        shrunk = shrinkage(result, read_all([sealed]), effects)
        row["shrinkage"] = asdict(shrunk) | {
            "share": shrunk.share(shrunk.found),
            "black_box_share": shrunk.share(shrunk.black_box),
        }
        moved = motion_error(result, effects)
        row["motion"] = asdict(moved) | {"share": moved.share} if moved else None
    return row


@contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        yield


if __name__ == "__main__":
    serve(lambda message: run_case(Case(**message["case"])))
