"""With what a result was made, for the JSON file and the foot of a page."""

from __future__ import annotations

import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any

from hybrid import __version__


def provenance(**given: Any) -> dict[str, Any]:
    """Versions of this package, of Python and of every core dependency.

    It holds no date, host or path, so the same run gives the same record.

    Args:
        **given: What else the result depends on: seeds, hashes of files, the command.

    Returns:
        JSON-ready; ``given`` comes first.
    """
    names = _core_dependencies()
    return {
        **given,
        "hybrid": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in names},
    }


def _core_dependencies() -> list[str]:
    try:
        lines = requires("hybrid-arm") or []
    except PackageNotFoundError:  # run from the source tree, without an installation
        return ["numpy", "scipy", "scikit-learn", "pin", "mujoco"]
    return [re.split(r"[^\w.-]", line)[0] for line in lines if "extra ==" not in line]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
