"""Write intervals of a simulator's parameters to files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from hybrid.exports.simulator.model import fields_of_model, usual_motion
from hybrid.exports.simulator.ranges import ranges
from hybrid.exports.simulator.snippets import isaac_events, mjx
from hybrid.model.dynamic_model import DynamicModel

_DRAWS = 400


def write_ranges(model: DynamicModel, folder: Path, stem: str) -> None:
    """Write intervals and correlations as YAML, and Python for Isaac Lab and MJX.

    Draws have a fixed seed, so that the files of a model are always the same.
    """
    found = ranges(model, np.random.default_rng(0), draws=_DRAWS)
    nominal = fields_of_model(model, (usual_motion(model),))
    # Isaac Lab has one dry and one viscous friction, as URDF has.
    plain = ranges(model, np.random.default_rng(0), kind="urdf", draws=_DRAWS)
    names = "damping", "quadratic", "cubic", "frictionloss"
    values = {x: getattr(nominal, x) for x in names}
    values["armature"] = nominal.chain.armature
    name = model.robot.name
    texts = {
        f"{stem}_ranges.yaml": yaml.safe_dump(
            {"robot": name, **found.as_dict()}, sort_keys=False, allow_unicode=True
        ),
        f"{stem}_isaaclab_events.py": isaac_events(name, plain),
        f"{stem}_mjx.py": mjx(name, found, values),
    }
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
