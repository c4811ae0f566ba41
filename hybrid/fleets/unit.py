"""The work on one unit: it reads logs and returns a few rows.

It runs in its own process, see :mod:`hybrid.fleets.worker`, and knows nothing of the
fleet. An error of a log is a row.
"""

import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from hybrid.errors import HybridError
from hybrid.fleets.estimate import deviations, with_payload
from hybrid.fleets.plan import opened
from hybrid.fleets.worker import FINDING, LOST, OK, REFUSED, VERDICT, serve
from hybrid.identification import DynamicModel, identify
from hybrid.model.model_file import content_from_model
from hybrid.recording import Recording, read_all
from hybrid.robot import Robot
from hybrid.robot.library import robot_file
from hybrid.threads import one_thread


@one_thread
def answer(message: Mapping[str, Any]) -> dict[str, Any]:
    """Do the task of a message: ``baseline`` returns a model, the others rows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if message["task"] == "baseline":
                return _baseline(message)
            model = with_payload(_model(message["model"]), message["payload"])
            logs = _read(message["logs"], model.robot.joints, message["map"])
            task = {"period": _period, "diagnosis": _diagnosis}[message["task"]]
            return {"rows": list(task(message, model, logs))}
        except HybridError as error:
            return {"failed": REFUSED, "reason": _one_line(error)}
        except OSError as error:  # the network or a full disk, not the log
            return {"failed": LOST, "reason": _one_line(error)}


def _baseline(message: Mapping[str, Any]) -> dict[str, Any]:
    """The model of the first period whose logs are valid."""
    reason = "no period"
    with _local_copies([message["robot"]]) as (path,):
        robot = Robot.load(robot_file(str(path)), joints=message["joints"] or None)
    for period, logs in message["periods"]:
        try:
            found = _read(logs, robot.joints, message["map"])
            # Friction stays linear, so that parameters of all arms are comparable.
            fit = identify(robot, found, stages=("rigid",))
            return {"period": period, "model": content_from_model(fit.model)}
        except HybridError as error:
            reason = reason if reason != "no period" else _one_line(error)
    return {"period": None, "reason": reason}


def _period(
    message: Mapping[str, Any], model: DynamicModel, logs: Sequence[Recording]
) -> Iterator[dict[str, Any]]:
    """Rows of the parameters of one arm in one period."""
    for row in deviations(model, logs, message["track"], message["tool"]):
        yield {"status": OK, **vars(row)}


def _diagnosis(
    message: Mapping[str, Any], model: DynamicModel, logs: Sequence[Recording]
) -> Iterator[dict[str, Any]]:
    """Rows of the verdict and the findings of a diagnosis, which takes minutes."""
    from hybrid.diagnosis.diagnose import diagnose

    found = diagnose(model, logs)
    yield {"status": VERDICT, "reason": found.verdict}
    for x in found.findings:
        where = ", ".join(x.joints)
        row = {"joint": where, "parameter": x.effect, "reason": x.sentence}
        yield {"status": FINDING, **row}


def _read(
    paths: Sequence[str], joints: tuple[str, ...], how: str | None
) -> list[Recording]:
    with _local_copies(paths) as files:
        return read_all(files, joints=joints, map=how)


@contextmanager
def _local_copies(paths: Sequence[str]) -> Iterator[list[Path]]:
    """Local paths; remote files are copied, and removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="hybrid-fleet-") as folder:
        found = []
        for k, path in enumerate(paths):
            if "://" not in path:
                found.append(Path(path))
                continue
            fs, root = opened(path)
            target = Path(folder) / str(k) / Path(root).name
            target.parent.mkdir()
            fs.get(root, str(target), recursive=fs.isdir(root))
            found.append(target)
        yield found


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@lru_cache(maxsize=64)
def _model(text: str) -> DynamicModel:
    with tempfile.TemporaryDirectory(prefix="hybrid-fleet-") as folder:
        path = Path(folder) / "model.json"
        path.write_text(text, encoding="utf-8")
        return DynamicModel.load(path)


if __name__ == "__main__":
    serve(answer)
