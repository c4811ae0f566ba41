"""The kinematic chain as constant arrays: all that batched dynamics needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RobotError

Array = NDArray[np.float64]

INERTIAL_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIAL_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)


@dataclass(frozen=True)
class Chain:
    """A serial chain of one-axis joints; link k hangs on joint k.

    Frames sit on the joint axes. The pose of link k in link k−1 is
    ``translation[k]``, ``rotation[k] · R(axis[k], q[k])`` for a revolute joint, and
    ``translation[k] + rotation[k] · axis[k] q[k]`` for a prismatic one.

    Attributes:
        joints: Joint names from base to tip, length n.
        rotation: Fixed rotation of each joint frame in its parent, shape (n, 3, 3).
        translation: Fixed offset of each joint frame in its parent, shape (n, 3), [m].
        axis: Unit joint axis in the link's own frame, shape (n, 3).
        revolute: True for a revolute joint, False for a prismatic one, shape (n,).
        inertial: Parameters of each link about its frame origin, in the order of
            ``INERTIAL_NAMES`` (m, m·c, I), shape (n, 10).
        gravity: Acceleration of gravity in the base frame, shape (3,), [m/s²].
        armature: Declared reflected rotor inertia, shape (n,), [kg·m²].

    Raises:
        RobotError: There is no joint, two have one name, or an array has another shape
            or holds NaN or infinity.
    """

    joints: tuple[str, ...]
    rotation: Array
    translation: Array
    axis: Array
    revolute: NDArray[np.bool_]
    inertial: Array
    gravity: Array
    armature: Array

    def __post_init__(self) -> None:
        n = self.size
        if not 0 < n == len(set(self.joints)):
            raise RobotError(
                f"joints are {', '.join(self.joints)}: one or more "
                "different names are valid"
            )
        shapes = {
            "rotation": (n, 3, 3), "translation": (n, 3), "axis": (n, 3),
            "revolute": (n,), "inertial": (n, 10), "gravity": (3,), "armature": (n,),
        }  # fmt: skip
        for name, shape in shapes.items():
            x = getattr(self, name)
            if x.shape != shape or not np.isfinite(x).all():
                raise RobotError(
                    f"{name} has shape {x.shape}; valid are finite numbers of shape "
                    f"{shape}"
                )

    @property
    def size(self) -> int:
        """Number of joints n."""
        return len(self.joints)
