"""Arms by name: those of this repository, and two of the example-robot-data wheel."""

import warnings
from importlib.metadata import files
from pathlib import Path

from hybrid.errors import HybridWarning
from hybrid.robot import Robot

MODELS = Path(__file__).parents[1] / "models"
PUBLIC = {
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
}


def arm(name: str) -> Robot:
    """The robot of that name."""
    if name not in PUBLIC:
        return Robot.load(MODELS / f"{name}.xml")
    for file in files("example-robot-data") or ():
        if file.as_posix().endswith(f"example-robot-data/robots/{PUBLIC[name]}"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", HybridWarning)  # frozen fingers
                return Robot.load(str(file.locate()))
    raise SystemExit("the example-robot-data wheel is needed: pip install '.[dev]'")
