"""The kinematic chain as constant arrays, for batched dynamics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.errors import RobotError
from hybrid.names import name_fault

INERTIAL_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIAL_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)
MOST_JOINTS = 128
_ROUNDING = 1e-6  # of a rotation or a unit axis; files have six digits
_MOST_GRAVITY = 1e3  # m/s²; a hundred times that of the earth
# Unit at a revolute joint -> unit at a prismatic joint.
_PRISMATIC = (("kg·m²", "kg"), ("(N·m)", "N"), ("N·m", "N"), ("rad", "m"))


@dataclass(frozen=True)
class Chain:
    """A serial chain of joints with one axis each; joint k moves link k.

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
        RobotError: There is no joint, there are too many joints, a name is not valid or
            not unique, or an array has a wrong shape or wrong values.
    """

    joints: tuple[str, ...]
    rotation: Array
    translation: Array
    axis: Array
    revolute: Mask
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
        if n > MOST_JOINTS:
            raise RobotError(f"{n} joints; valid are up to {MOST_JOINTS}")
        for fault in filter(None, map(name_fault, self.joints)):
            raise RobotError(f"joint {fault}")
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
        self._check_values()

    def _check_values(self) -> None:
        gram = self.rotation @ self.rotation.transpose(0, 2, 1) - np.eye(3)
        turned = np.linalg.det(self.rotation)
        length = np.linalg.norm(self.axis, axis=1)
        for name, fault, wanted in (
            ("rotation", np.abs(gram).max((1, 2)) > _ROUNDING, "orthonormal"),
            ("rotation", turned < 0, "right-handed"),
            ("axis", np.abs(length - 1) > _ROUNDING, "of length 1"),
        ):
            if fault.any():
                joint = self.joints[int(np.argmax(fault))]
                raise RobotError(f"{name} of joint {joint!r} is not {wanted}")
        if self.revolute.dtype != bool:
            raise RobotError("revolute holds more than True and False")
        if np.linalg.norm(self.gravity) > _MOST_GRAVITY:
            raise RobotError(
                f"gravity is {self.gravity} m/s²; valid is up to {_MOST_GRAVITY:g}"
            )

    @property
    def size(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    def unit_at(self, joints: Sequence[int], unit: str) -> str:
        """Convert a unit that is stated for revolute joints to that of some joints.

        It stays for both kinds of joints together.
        """
        if len(joints) and not self.revolute[list(joints)].any():
            return unit_of_slide(unit)
        return unit

    def units(self, unit: str) -> tuple[str, ...]:
        """A unit that is stated for revolute joints, at each joint."""
        return tuple(self.unit_at([k], unit) for k in range(self.size))


def unit_of_slide(unit: str) -> str:
    """Convert a unit that is stated for revolute joints to that of prismatic ones."""
    for revolute, prismatic in _PRISMATIC:
        unit = unit.replace(revolute, prismatic)
    return unit
