"""Reader of the YAML file that describes a simulated plant."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import effect_from_dict
from hybrid.errors import HybridError
from hybrid.files import checked_table, read_yaml
from hybrid.plant.noise import Noise
from hybrid.plant.plant import Plant
from hybrid.robot.library import robot_file
from hybrid.robot.robot import Robot
from hybrid.robot.spatial import central_inertia, inertial_about

_KEYS = ("robot", "inertial", "effects", "noise", "plant")
_MULTIPLIERS = ("mass", "first_moment", "inertia")
_NOISE = (
    "torque_std", "torque_correlation", "position_resolution", "position_std",
    "speed_std", "correlation_time",
)  # fmt: skip
_PLANT = ("step", "control_rate", "log_rate", "integrator")


def load_truth(path: str | Path) -> tuple[Robot, Plant]:
    """Read a nominal robot and the plant that differs from it.

    The file names the ``robot`` (a file relative to itself, or a robot's name),
    multipliers of its links' ``inertial`` parameters (``joint``, and any of ``mass``,
    ``first_moment`` and ``inertia``, the last about the centre of mass), its
    ``effects`` (as in
    :meth:`Effect.as_dict`), the ``noise`` (``torque_std`` [N·m],
    ``torque_correlation``, ``position_resolution`` and ``position_std`` [rad],
    ``speed_std`` [rad/s], ``correlation_time`` [s]; one value for each joint, or one
    for all) and rates of the ``plant``. Only ``robot`` is needed.

    Args:
        path: YAML file.

    Returns:
        The nominal robot, and the plant. Its controller knows the nominal robot only.

    Raises:
        HybridError: The file cannot be read, or is not valid.
    """
    path = Path(path)
    content = checked_table(read_yaml(path), _KEYS, str(path))
    if "robot" not in content:
        raise HybridError(f"{path}: no robot")
    nominal = Robot.load(robot_file(str(content["robot"]), path.parent))
    try:
        real = _perturbed(nominal, content.get("inertial") or ())
        effects = [
            effect_from_dict(item, nominal.joints)
            for item in content.get("effects") or ()
        ]
        noise = _noise(content.get("noise"), nominal)
        options = checked_table(content.get("plant") or {}, _PLANT, "plant")
        plant = Plant(real, effects, nominal=nominal, noise=noise, **options)
    except HybridError as error:
        raise type(error)(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        raise HybridError(f"{path}: {error}") from error
    return nominal, plant


def _perturbed(robot: Robot, items: Any) -> Robot:
    """The arm with multiplied link parameters."""
    inertial = robot.chain.inertial.copy()
    if not isinstance(items, Sequence):
        raise HybridError("inertial needs a list of joints with multipliers")
    for entry in items:
        item = checked_table(entry, ("joint", *_MULTIPLIERS), "inertial")
        k = robot.joint_index(str(item.get("joint")))
        mass_by, moment_by, inertia_by = (
            float(item.get(key, 1.0)) for key in _MULTIPLIERS
        )
        if not min(mass_by, moment_by, inertia_by) > 0:
            raise HybridError("multipliers of inertial parameters must be above 0")
        mass, center, inertia = central_inertia(inertial[k])
        inertial[k] = inertial_about(
            mass * mass_by, center * moment_by / mass_by, inertia * inertia_by
        )
    return robot.with_inertial(inertial)


def _noise(content: Any, robot: Robot) -> Noise:
    if content is None:
        return Noise.typical(robot)
    item = checked_table(content, _NOISE, "noise")
    n = robot.size

    def each(key: str) -> Array:
        value = np.asarray(item.get(key, 0.0), dtype=float)
        if value.shape not in ((), (n,)):
            raise HybridError(f"noise: {key} needs one value, or one for each joint")
        return np.broadcast_to(value, (n,)).copy()

    std = each("torque_std")
    correlation = np.asarray(item.get("torque_correlation", np.eye(n)), dtype=float)
    if correlation.shape != (n, n):
        raise HybridError(f"noise: torque_correlation needs {n} rows of {n} values")
    return Noise(
        torque_covariance=np.outer(std, std) * correlation,
        position_resolution=each("position_resolution"),
        position_std=each("position_std"),
        speed_std=each("speed_std"),
        correlation_time=float(item.get("correlation_time", Noise.correlation_time)),
    )
