"""Find robot files by name, in this package and other installed packages."""

import os
from collections import Counter
from collections.abc import Mapping
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import PackageNotFoundError, files
from importlib.util import find_spec
from pathlib import Path

from hybrid.errors import RobotError
from hybrid.examples import example_robots

_MOST_NAMES = 12  # in an error
_EXAMPLES, _DESCRIPTIONS = "example-robot-data", "robot_descriptions"


def robot_file(source: str | Path, home: Path | None = None) -> Path:
    """Find the file of a robot by its path or its name.

    Names are searched first in ``example-robot-data`` (``ur5``, ``panda``), then in
    the cache of ``robot_descriptions`` (``ur5e``, ``ur5e_mj_description``), and last in
    this package (``coman_like``, and ``ur10`` without shapes of its links).

    Args:
        source: A path, or a name without a folder.
        home: Folder of a relative path.

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
    names = sorted({*examples, *shown, *own})
    if len(names) > _MOST_NAMES:
        near = get_close_matches(name, names, _MOST_NAMES) or sorted(own)
        names = [*near, f"{len(names) - len(near)} others"]
    more = "" if examples else f"; the package {_EXAMPLES} has more"
    raise RobotError(
        f"{name}: no such robot file; valid are files and {', '.join(names)}{more}"
    )


def _examples() -> Mapping[str, Path]:
    """Files of ``example-robot-data`` by name, or by folder if names are not unique."""
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
    """Repository of each robot in ``robot_descriptions``, by name."""
    if find_spec(_DESCRIPTIONS) is None:
        return {}
    known = import_module(f"{_DESCRIPTIONS}._descriptions").DESCRIPTIONS
    return {name: str(item.repository) for name, item in known.items()}


def _cached(name: str, repository: str) -> Path:
    """File of a description whose repository is in the cache.

    The module of a description would download its repository otherwise.
    """
    import git

    known = import_module(f"{_DESCRIPTIONS}._repositories").REPOSITORIES[repository]
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
    folder = Path(cache).expanduser() / known.cache_path
    try:
        git.Repo(folder).git.rev_parse("--verify", f"{known.commit}^{{commit}}")
    except git.exc.GitError as error:
        raise RobotError(
            f"{name}: not in the cache of {_DESCRIPTIONS}; run `python -m "
            f"{_DESCRIPTIONS} pull {name}` once"
        ) from error
    module = import_module(f"{_DESCRIPTIONS}.{name}")
    for kind in ("MJCF_PATH", "URDF_PATH"):
        if hasattr(module, kind):
            return Path(getattr(module, kind))
    try:  # a xacro file with its arguments, such as ur_type
        return Path(import_module(f"{_DESCRIPTIONS}._xacro").get_urdf_path(module))
    except ModuleNotFoundError as error:
        raise RobotError(
            f"{name}: a xacro file; install xacrodoc to expand it: pip install xacrodoc"
        ) from error
    except Exception as error:  # xacro raises any type for a template
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise RobotError(f"{name}: xacro cannot expand it ({reason})") from error
