"""What goes with an export: which model it is, and what its numbers mean."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid import __version__
from hybrid.errors import ModelFileError
from hybrid.identify.model import DynamicModel
from hybrid.identify.model_file import content_from_model
from hybrid.robot import Robot

SCHEMA = "hybrid.export/1"
FILE = "manifest.json"
_UNITS = {"q": "rad", "v": "rad/s", "a": "rad/s²", "tau": "N·m", "variance": "(N·m)²"}


def model_digest(model: DynamicModel) -> str:
    """SHA-256 of everything that a saved model holds, as it stands in its file."""
    return str(content_from_model(model)["sha256"])


def build_manifest(
    model: DynamicModel,
    *,
    format: str,
    digest: str,
    left_out: Sequence[str],
    memory: Sequence[str] = (),
) -> dict[str, Any]:
    """JSON-ready description of an export.

    Args:
        model: What is exported.
        format: Format of the export.
        digest: Hash of the model.
        left_out: What the format cannot express, and why.
        memory: What the exported model remembers between instants.
    """
    robot = model.robot
    limits = ("q_min", "q_max", "v_max", "a_max", "tau_max")
    return {
        "schema": SCHEMA,
        "version": __version__,
        "format": format,
        "model_sha256": digest,
        "robot": robot.name,
        "fingerprint": robot.fingerprint(),
        "joints": list(robot.joints),
        "units": _UNITS,
        "limits": {name: _finite(getattr(robot, name)) for name in limits},
        "training_range": {k: _finite(x) for k, x in sorted(model.range.items())},
        "cutoff": model.cutoff if np.isfinite(model.cutoff) else None,
        "effects": [effect.as_dict(robot.joints) for effect in model.effects],
        "remainder": None if model.remainder is None else model.remainder.as_dict(),
        "memory": list(memory),
        "left_out": list(left_out),
    }


def seal(manifest: Mapping[str, Any], folder: Path) -> None:
    """Write the manifest with the hashes of the folder's other files."""
    files = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.iterdir())
    }
    text = json.dumps({**manifest, "files": files}, ensure_ascii=False, indent=2)
    (folder / FILE).write_text(text + "\n", encoding="utf-8")


def read_manifest(
    folder: str | Path, *, robot: Robot | None = None, model: DynamicModel | None = None
) -> dict[str, Any]:
    """Check an export before it is used, and say what it is.

    Args:
        folder: Where it was exported to.
        robot: The arm that it shall be used on.
        model: The model that it shall be of.

    Raises:
        ModelFileError: It is of another version, arm or model, or a file was changed.
    """
    folder = Path(folder)
    path = folder / FILE
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        schema, version, files = (content[k] for k in ("schema", "version", "files"))
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ModelFileError(f"{path}: not a manifest ({error!r})") from error
    if schema != SCHEMA or _series(version) != _series(__version__):
        raise ModelFileError(
            f"{path}: exported by version {version} ({schema}), this is "
            f"{__version__} ({SCHEMA}); export the model again"
        )
    if robot is not None and (
        content["fingerprint"] != robot.fingerprint()
        or tuple(content["joints"]) != robot.joints
    ):
        raise ModelFileError(
            f"{path}: of arm {content['robot']} with joints "
            f"{', '.join(content['joints'])}; this is {robot.name} with "
            f"{', '.join(robot.joints)}"
        )
    if model is not None and content["model_sha256"] != model_digest(model):
        raise ModelFileError(f"{path}: of another model; export this one")
    for name, digest in files.items():
        file = folder / Path(name).name
        if not file.is_file():
            raise ModelFileError(f"{file}: missing; {FILE} names it")
        if hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            raise ModelFileError(f"{file}: changed since it was exported")
    return content


def _series(version: str) -> list[str]:
    """Versions of one series read each other's files."""
    return str(version).split(".")[:2]


def _finite(values: Any) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in values]
