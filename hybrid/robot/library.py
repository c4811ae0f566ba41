"""Robots by name: files that this package or others have put on this computer."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import PackageNotFoundError, files
from importlib.util import find_spec
from pathlib import Path

from hybrid.errors import RobotError
from hybrid.examples import example_robots

_EXAMPLES, _DESCRIPTIONS = "example-robot-data", "robot_descriptions"


def robot_file(source: str | Path, home: Path | None = None) -> Path:
    """The file of a robot that is given by its path or by a name.

    Names are those of the files of ``example-robot-data`` (``ur5``, ``panda``), and
    after them those of ``robot_descriptions`` (``ur5e``, ``ur5e_mj_description``), of
    which only what its cache holds is used. Last come the arms of this package
    (``coman_like``, and ``ur10`` without the shapes of its links).

    Args:
        source: A path; or a name, which has no folder.
        home: Folder that a path starts from.

    Raises:
        RobotError: No robot has the name, or it is not on this computer.
    """
    path = Path(home or "", source)
    name = str(source)
    if path.is_file() or Path(name).name != name:
        return path
    examples, own = _examples(), example_robots()
    if name in examples:
        return examples[name]
    described = _described()
    for known in (name, f"{name}_mj_description", f"{name}_description"):
        if known in described:
            return _cached(known, described[known])
    if name in own:
        return own[name]
    if Path(name).suffix:
        return path
    shown = {x.removesuffix("_description") for x in described}
    names = ", ".join(sorted({*examples, *shown, *own}))
    more = "" if examples else f"; the package {_EXAMPLES} has more"
    raise RobotError(f"{name}: no such robot file; valid are files and {names}{more}")


def _examples() -> Mapping[str, Path]:
    """Files of the package ``example-robot-data``; the folder tells namesakes apart."""
    try:
        listed = files(_EXAMPLES) or ()
    except PackageNotFoundError:
        return {}
    found = [Path(str(x.locate())) for x in listed if x.suffix == ".urdf"]
    often = Counter(path.stem for path in found)
    names = {}
    for path in found:
        folder = path.parents[1].name.removesuffix("_description")
        names[path.stem if often[path.stem] == 1 else folder] = path
    return {name.removesuffix("_robot"): names[name] for name in sorted(names)}


def _described() -> Mapping[str, str]:
    """Names that ``robot_descriptions`` knows, and the repository of each."""
    if find_spec(_DESCRIPTIONS) is None:
        return {}
    known = import_module(f"{_DESCRIPTIONS}._descriptions").DESCRIPTIONS
    return {name: str(item.repository) for name, item in known.items()}


def _cached(name: str, repository: str) -> Path:
    """File of a description whose repository was fetched before.

    The module of a description fetches its repository unless the cache has it.
    """
    known = import_module(f"{_DESCRIPTIONS}._repositories").REPOSITORIES[repository]
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
    folder = Path(cache).expanduser() / known.cache_path
    if not _has(folder, known.commit):
        raise RobotError(
            f"{name}: not in the cache of {_DESCRIPTIONS}; run `python -m "
            f"{_DESCRIPTIONS} pull {name}` once"
        )
    module = import_module(f"{_DESCRIPTIONS}.{name}")
    for kind in ("MJCF_PATH", "URDF_PATH"):
        if hasattr(module, kind):
            return Path(getattr(module, kind))
    try:  # of a xacro file and what it is to be given, such as ur_type
        return Path(import_module(f"{_DESCRIPTIONS}._xacro").get_urdf_path(module))
    except ModuleNotFoundError as error:
        raise RobotError(
            f"{name}: a xacro file; install xacrodoc to expand it: pip install xacrodoc"
        ) from error
    except Exception as error:  # a template ends in any error of xacro
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise RobotError(f"{name}: xacro cannot expand it ({reason})") from error


def _has(folder: Path, commit: str) -> bool:
    """Whether a folder is a repository that knows a commit."""
    import git

    try:
        git.Repo(folder).git.rev_parse("--verify", f"{commit}^{{commit}}")
    except git.exc.GitError:
        return False
    return True
