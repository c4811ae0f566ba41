"""Read a robot from a file, a name, or a model of another library."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hybrid.errors import RobotError
from hybrid.robot.compiled import compiled_spec, compiled_without_files
from hybrid.robot.library import robot_file
from hybrid.robot.measure import check_demand
from hybrid.robot.mjcf import fields_of_mujoco
from hybrid.robot.urdf import fields_of_pinocchio, read_urdf

SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro")
Read = tuple[dict[str, Any], Any]  # fields, and MuJoCo's model or None


def read_robot(
    source: Any, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> Read:
    """Fields of a robot from a file, a name, or another library's model.

    Raises:
        RobotError: It is none of these, or holds no serial arm.
    """
    home = type(source).__module__.partition(".")[0]
    match home, type(source).__name__:
        case ("mujoco", "MjModel"):
            return _of_mujoco((source.__copy__(), {}), "MjModel", joints, held)
        case ("mujoco", "MjSpec"):
            spec = source.copy()
            return _of_mujoco(compiled_spec(spec, "MjSpec"), "MjSpec", joints, held)
        case ("pinocchio", "Model"):
            where = "pinocchio.Model"
            return fields_of_pinocchio(source, where, joints, held, {}), None
    if not isinstance(source, (str, Path)):
        raise RobotError(
            f"{home}.{type(source).__name__} is no robot; valid are a file, a name, "
            "mujoco.MjModel, mujoco.MjSpec and pinocchio.Model"
        )
    path = robot_file(source)
    try:
        return _of_file(path, joints, held)
    except RobotError as error:
        if str(path) in str(error):
            raise
        raise RobotError(f"{path}: {error}") from error
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: a name in it is not UTF-8 ({error})") from error


def _of_mujoco(
    made: tuple[Any, Mapping[int, str]],
    where: str,
    joints: tuple[str, ...] | None,
    held: Mapping[str, float],
) -> Read:
    model, wanting = made
    fields = fields_of_mujoco(model, where, joints, held, wanting)
    name = model.names[: model.names.index(b"\0")].decode()
    return {"name": name, **fields}, model


def _of_file(
    path: Path, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> Read:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RobotError(
            f"{path}: unknown kind of robot file; valid are {', '.join(SUFFIXES)}"
        )
    if not path.is_file():
        raise RobotError(f"{path}: no such robot file")
    if suffix == ".xacro":
        return {**_of_xacro(path, joints, held), "path": str(path)}, None
    check_demand(path)
    if suffix == ".urdf":
        return {**read_urdf(path, joints, held), "path": str(path)}, None
    made = compiled_without_files(path)
    fields, model = _of_mujoco(made, str(path), joints, held)
    return {**fields, "name": path.stem, "path": str(path)}, model


def expanded(path: Path) -> str:
    """A xacro file as URDF.

    Raises:
        RobotError: xacro is not installed, or cannot expand the file.
    """
    by_hand = f"xacro {path.name} > {path.name.split('.')[0]}.urdf"
    try:
        import xacro
    except ModuleNotFoundError as error:
        raise RobotError(
            f"{path}: install xacro to expand it, or run `{by_hand}`"
        ) from error
    try:
        return str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # its own, and those of Python in a file's expressions
        reason = " ".join(str(error).split())
        raise RobotError(
            f"{path}: xacro cannot expand it ({reason}); try `{by_hand}`"
        ) from error


def _of_xacro(
    path: Path, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> dict[str, Any]:
    text = expanded(path)
    with TemporaryDirectory() as folder:
        file = Path(folder, f"{path.name.split('.')[0]}.urdf")
        file.write_text(text, encoding="utf-8")
        try:
            check_demand(file)
            return read_urdf(file, joints, held)
        except RobotError as error:
            raise RobotError(str(error).replace(str(file), str(path))) from error
