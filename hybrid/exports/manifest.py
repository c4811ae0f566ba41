"""Manifest of an export: its model, units, limits and files."""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hybrid import __version__
from hybrid.errors import ModelFileError
from hybrid.files import read_json, write_json
from hybrid.model.dynamic_model import DynamicModel
from hybrid.model.model_file import content_from_model
from hybrid.shown import plain

SCHEMA = "hybrid.export/2"
FILE = "manifest.json"
_UNITS = {
    "q": "rad", "v": "rad/s", "a": "rad/s²", "tau": "N·m", "variance": "(N·m)²",
}  # fmt: skip
_TRIES = 100  # to read a folder that other processes replace meanwhile


def build_manifest(
    model: DynamicModel,
    *,
    format: str,
    left_out: Sequence[str],
    memory: Sequence[str] = (),
) -> dict[str, Any]:
    """Description of an export for JSON.

    A unit is a text if all joints have the same, else a list with one for each joint.
    """
    robot = model.robot
    limits = ("q_min", "q_max", "v_max", "a_max", "tau_max")
    units = {name: robot.chain.units(unit) for name, unit in _UNITS.items()}
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "format": format,
        "model_sha256": content_from_model(model)["sha256"],
        "robot": robot.name,
        "fingerprint": robot.fingerprint(),
        "joints": robot.joints,
        "units": {k: x[0] if len({*x}) == 1 else x for k, x in units.items()},
        "limits": {name: getattr(robot, name) for name in limits},
        "training_range": dict(sorted(model.range.items())),
        "cutoff": model.cutoff,
        "effects": [effect.as_dict(robot.joints) for effect in model.effects],
        "remainder": None if model.remainder is None else model.remainder.as_dict(),
        "memory": memory,
        "left_out": left_out,
    }
    return dict(plain(content))


def seal(manifest: Mapping[str, Any], folder: Path, before: Path) -> None:
    """Write the manifest, with the hashes of all files of the export.

    Args:
        manifest: Description of the export.
        folder: Folder of its files.
        before: The folder that it will replace. The manifests of other formats in it
            are kept under ``beside``.
    """
    files = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.iterdir())
    }
    beside: dict[str, Any] = {}
    with suppress(ModelFileError):
        older = dict(_read(before / FILE))
        beside = older.pop("beside", {}) | {older["format"]: older}
    beside.pop(manifest["format"], None)
    write_json(folder / FILE, {**manifest, "files": files, "beside": beside})


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """Check an export before it is used, and return its manifest.

    Raises:
        ModelFileError: It is of another version, or a file was changed.
    """
    folder = Path(folder)
    for left in reversed(range(_TRIES)):
        content: dict[str, Any] = _read(folder / FILE)
        try:
            for each in (content, *content["beside"].values()):
                _check_files(folder, each["files"])
            break
        except ModelFileError:
            if not left or content == _read(folder / FILE):
                raise  # it was not replaced meanwhile
    return content


def _read(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = read_json(path)
        schema, version = content["schema"], content["version"]
        wrong = schema != SCHEMA or _series(version) != _series(__version__)
        named = [content, *content["beside"].values()] if not wrong else []
        for each in named:
            _ = dict(each["files"]), each["format"], ", ".join(each["joints"])
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelFileError(f"{path}: not a manifest ({error!r})") from error
    if wrong:
        raise ModelFileError(
            f"{path}: exported by version {version} ({schema}), this is "
            f"{__version__} ({SCHEMA}); export the model again"
        )
    return content


def _check_files(folder: Path, files: Mapping[str, str]) -> None:
    for name, digest in files.items():
        file = folder / Path(name).name
        if not file.is_file():
            raise ModelFileError(f"{file}: missing; {FILE} names it")
        if hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            raise ModelFileError(f"{file}: changed since it was exported")


def _series(version: str) -> list[str]:
    """Major and minor version; versions that share them read each other's files."""
    return str(version).split(".")[:2]
