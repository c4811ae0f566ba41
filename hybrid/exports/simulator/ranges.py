"""Intervals of a simulator's parameters, for domain randomisation."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.exports.simulator.model import fields_of_model, usual_motion
from hybrid.exports.simulator.posterior import sample
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.robot.chain import INERTIAL_NAMES, INERTIAL_UNITS

_LEVEL = 0.95
_ROUNDING = 1e-9  # of the largest number of that unit: less variation is none
_UNITS = {
    "armature": "kg·m²", "damping": "N·m·s/rad", "quadratic": "N·m·s²/rad²",
    "cubic": "N·m·s³/rad³", "frictionloss": "N·m", "stiffness": "N·m/rad",
    "preload": "N·m", "knee": "N·m", "fall": "N·m",
}  # fmt: skip
_NAMES = (*_UNITS, *INERTIAL_NAMES)


@dataclass(frozen=True)
class Ranges:
    """The p uncertain parameters of a simulator, with their intervals.

    Attributes:
        robot: The arm with the nominal values.
        keys: Joint and name of each parameter, length p.
        units: Units, length p.
        nominal: Values of the simulator, shape (p,).
        low: Lower ends of the 95 % intervals, shape (p,).
        high: Upper ends of the 95 % intervals, shape (p,).
        correlation: Correlations, shape (p, p).
        draws: Draws from the posterior, shape (draws, p).
    """

    robot: Robot
    keys: tuple[tuple[str, str], ...]
    units: tuple[str, ...]
    nominal: Array
    low: Array
    high: Array
    correlation: Array
    draws: Array

    def as_dict(self) -> dict[str, Any]:
        """Content of the YAML file."""
        return {
            "level": _LEVEL,
            "parameters": [
                {
                    "joint": joint,
                    "name": name,
                    "unit": self.units[k],
                    "nominal": float(self.nominal[k]),
                    "interval": [float(self.low[k]), float(self.high[k])],
                }
                for k, (joint, name) in enumerate(self.keys)
            ],
            "correlation": np.round(self.correlation, 4).tolist(),
        }


def ranges(
    model: DynamicModel,
    seed: int | np.random.Generator = 0,
    *,
    kind: str = "mjcf",
    draws: int = 400,
    links: bool = True,
) -> Ranges:
    """Intervals and correlations of parameters, from draws of the posterior.

    The kind, ``mjcf``, ``urdf`` or ``isaaclab``, says what parameters the simulator
    has. Friction of all draws rises (``knee``) and falls (``fall``) at the same speeds.
    Without ``links``, those of the model are taken as they are.

    Raises:
        HybridError: See :func:`.sample`.
    """
    drawn = sample(model, draws, seed, links=links)
    motions = (usual_motion(model),)
    form = fields_of_model(model, motions, kind)
    nominal = _numbers(form)
    values = np.array([
        _numbers(fields_of_model(x, motions, kind, form)) for x in drawn
    ])  # fmt: skip
    joints, unit_at = model.robot.joints, model.robot.chain.unit_at
    units = np.array([
        [*(unit_at([j], x) for x in _UNITS.values()), *INERTIAL_UNITS]
        for j in range(len(joints))
    ])  # fmt: skip
    highest, size = np.abs(values).max(axis=0), np.empty_like(nominal)
    for unit in np.unique(units):
        size[units == unit] = highest[units == unit].max()
    varies = np.ptp(values, axis=0) > _ROUNDING * size
    values = values[:, varies]
    tail = 100 * (1 - _LEVEL) / 2
    low, high = np.percentile(values, [tail, 100 - tail], axis=0)
    return Ranges(
        robot=form,
        keys=tuple((joints[j], _NAMES[k]) for j, k in np.argwhere(varies)),
        units=tuple(units[varies].tolist()),
        nominal=nominal[varies],
        low=low,
        high=high,
        correlation=np.atleast_2d(np.corrcoef(values, rowvar=False)),
        draws=values,
    )


def joint_numbers(robot: Robot) -> dict[str, Array]:
    """Rotor, friction and spring of every joint by name, shape (n,) each."""
    fall = np.zeros(robot.size)
    np.add.at(fall, robot.falling[:, 0].astype(int), robot.falling[:, 1])
    own = {
        "armature": robot.chain.armature,
        "preload": -robot.stiffness * robot.springref,
        "fall": fall,
    }
    return {x: own[x] if x in own else getattr(robot, x) for x in _UNITS}


def _numbers(robot: Robot) -> Array:
    """All numbers of a simulator, a row for each joint and its link, shape (n, 19)."""
    return np.column_stack([*joint_numbers(robot).values(), robot.chain.inertial])
