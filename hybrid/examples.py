"""Robots and a log that come with the package, under their names."""

from collections.abc import Mapping
from pathlib import Path


def examples_folder() -> Path:
    """The folder of examples: in the package, or beside it in a checkout."""
    package = Path(__file__).parent
    installed = package / "models"
    return installed if installed.is_dir() else package.parent / "models"


def example_robots() -> Mapping[str, Path]:
    """Robot files by name; where there are two of an arm, the MJCF file."""
    found = sorted(examples_folder().glob("*.*"), key=lambda x: x.suffix != ".urdf")
    return {x.stem: x for x in found if x.suffix in (".urdf", ".xml")}
