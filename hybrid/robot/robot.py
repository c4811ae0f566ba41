"""A serial arm: its chain, its limits, and the friction that its file declares."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import mujoco
import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.errors import RobotError, warn
from hybrid.names import name_fault
from hybrid.robot.build import mujoco_spec, pinocchio_model
from hybrid.robot.chain import Chain
from hybrid.robot.read import read_robot
from hybrid.robot.unmodelled import check_modelled
from hybrid.shown import plain

if TYPE_CHECKING:
    import pinocchio

    Source: TypeAlias = str | Path | mujoco.MjModel | mujoco.MjSpec | pinocchio.Model
else:
    Source = Any  # pinocchio takes half a second

# Younger than the first models that were saved.
_LATER = (
    "quadratic", "cubic", "stiffness", "springref", "knee", "knee_speed", "latency",
)  # fmt: skip
_NEEDED = ("q_min", "q_max", "v_max", "tau_max", "damping", "frictionloss")
# Arrays with a value for each joint, and the value of a joint without one.
_VECTORS = {
    "q_min": -np.inf, "q_max": np.inf, "v_max": np.inf, "a_max": np.inf,
    "tau_max": np.inf, "damping": 0.0, "frictionloss": 0.0,
    **dict.fromkeys(_LATER, 0.0), "kp": np.nan, "kd": np.nan,
}  # fmt: skip
# Numbers in a row.
_ROWS = {"ripple": 4, "falling": 3, "coupled": 5, "bristle": 5, "stiffening": 4}


@dataclass(frozen=True, repr=False, eq=False)
class Robot:
    """The nominal simulator of a serial arm of n joints.

    The torque of a drive is that of the links, and of rotor, friction and spring at its
    joint: armature·a + damping·v + quadratic·v|v| + cubic·v³ +
    stiffness·(q − springref) + frictionloss·sgn v + knee·clip(v / knee_speed),
    ripples sine·sin(k q) + cosine·cos(k q), Stribeck friction
    level·exp(−(v/v_s)²)·sgn v, and stiffening springs, which pull with
    stiffness·d·(1 + (d/knee)²) when they are bent by d. Where one rotor turns with the
    sum of two joints, both have inertia·(a₁ + a₂) + damping·(v₁ + v₂) +
    dry·sgn(v₁ + v₂).

    Attributes:
        name: Name in the file.
        chain: Kinematics and inertial parameters.
        q_min: Lower position limits, shape (n,), [rad or m]; −inf without one.
        q_max: Upper position limits, shape (n,), [rad or m]; inf without one.
        v_max: Speed limits, shape (n,), [rad/s or m/s]; inf without one.
        tau_max: Rated torques, shape (n,), [N·m or N]; inf without one.
        a_max: Acceleration limits, shape (n,), [rad/s² or m/s²]; inf without one.
        damping: Declared viscous friction, shape (n,), [N·m·s/rad].
        frictionloss: Declared dry friction, shape (n,), [N·m].
        path: File it was read from.
        kp: Declared stiffness of position servos, shape (n,), [N·m/rad]; NaN without
            a servo.
        kd: Declared damping of servos, shape (n,), [N·m·s/rad]; NaN without a servo.
        timestep: Declared step of the simulation, [s]; NaN without one.
        quadratic: Declared quadratic friction, shape (n,), [N·m·s²/rad²].
        cubic: Declared cubic friction, shape (n,), [N·m·s³/rad³].
        stiffness: Declared stiffness of springs, shape (n,), [N·m/rad].
        springref: Rest position of springs, shape (n,), [rad or m].
        knee: Declared level of friction that is linear at low speed, shape (n,), [N·m].
        knee_speed: Speed from which it is constant, shape (n,), [rad/s].
        ripple: Declared ripples, shape (R, 4): joint, sine [N·m], cosine [N·m] and k,
            [1/rad].
        falling: Declared Stribeck friction, shape (F, 3): joint, level [N·m], and v_s
            [rad/s].
        coupled: Declared rotors that turn with the sum of two joints, shape (C, 5):
            both joints, inertia [kg·m²], damping [N·m·s/rad] and dry friction [N·m].
        bristle: Declared friction of servos by bristles, shape (S, 5): joint, sliding
            friction [N·m], static less sliding friction [N·m], v_s [rad/s], and bend of
            the bristles that slide [rad]. Motors behind it have that friction; the
            torque above is without it.
        stiffening: Declared stiffening springs, shape (K, 4): joint, stiffness
            [N·m/rad], rest position [rad], and knee [rad], at which they pull twice as
            hard as a linear spring.
        latency: Declared delay of commands, shape (n,), [s].
        held: Positions of joints outside the arm, [rad or m], if they differ from the
            file.
    """

    name: str
    chain: Chain
    q_min: Array
    q_max: Array
    v_max: Array
    tau_max: Array
    damping: Array
    frictionloss: Array
    a_max: Array = field(default_factory=lambda: np.zeros(0))
    path: str = ""
    kp: Array = field(default_factory=lambda: np.zeros(0))
    kd: Array = field(default_factory=lambda: np.zeros(0))
    timestep: float = np.nan
    quadratic: Array = field(default_factory=lambda: np.zeros(0))
    cubic: Array = field(default_factory=lambda: np.zeros(0))
    stiffness: Array = field(default_factory=lambda: np.zeros(0))
    springref: Array = field(default_factory=lambda: np.zeros(0))
    knee: Array = field(default_factory=lambda: np.zeros(0))
    knee_speed: Array = field(default_factory=lambda: np.zeros(0))
    ripple: Array = field(default_factory=lambda: np.zeros((0, 4)))
    falling: Array = field(default_factory=lambda: np.zeros((0, 3)))
    coupled: Array = field(default_factory=lambda: np.zeros((0, 5)))
    bristle: Array = field(default_factory=lambda: np.zeros((0, 5)))
    stiffening: Array = field(default_factory=lambda: np.zeros((0, 4)))
    latency: Array = field(default_factory=lambda: np.zeros(0))
    held: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.name and (fault := name_fault(self.name)):
            raise RobotError(f"arm {fault}")
        for name, none in _VECTORS.items():
            if getattr(self, name).size == 0 and name not in _NEEDED:
                object.__setattr__(self, name, np.full(self.size, none))
            x = getattr(self, name)
            servo = np.isnan(none)
            if x.shape != (self.size,) or ((x < 0) if servo else np.isnan(x)).any():
                value = "one value, 0 or above or none," if servo else "one value"
                raise RobotError(f"{name} needs {value} for each of {self.joints}")
        if (self.q_min > self.q_max).any():
            joint = self.joints[int(np.argmax(self.q_min > self.q_max))]
            where = f"{self.path}: " if self.path else ""
            raise RobotError(f"{where}q_min of joint {joint!r} is above its q_max")

    @classmethod
    @typed
    def load(
        cls,
        source: Source,
        *,
        joints: tuple[str, ...] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> Robot:
        """Read a serial arm from a robot file, by name, or from a model of a library.

        Args:
            source: A ``.urdf``, ``.xml``, ``.mjcf`` or ``.xacro`` file (meshes are not
                needed if links have inertias); the name of a robot of
                ``example-robot-data`` or ``robot_descriptions``; or a model of MuJoCo
                or pinocchio, which is not changed.
            joints: Joints to keep; the others are held at their positions in the file.
                By default the longest chain, which ends where a gripper forks.
            held: Positions of other joints by name, [rad or m].

        Raises:
            RobotError: The file is missing or unreadable, holds no serial arm, or
                declares forces on the arm that are not modelled.

        Warns:
            HybridWarning: Joints outside the arm are held; the file compensates
                gravity; or friction or a rotor is below zero.
        """
        held = {} if held is None else {name: float(x) for name, x in held.items()}
        fields, model = read_robot(source, joints, held)
        robot = cls(**fields)
        robot._warn_of_negative()
        if model is not None:
            check_modelled(robot, model)
        return robot

    def _warn_of_negative(self) -> None:
        values = {
            "damping": self.damping, "dry friction": self.frictionloss,
            "rotor inertia": self.chain.armature,
        }  # fmt: skip
        for name, x in values.items():
            for j in np.flatnonzero(x < 0).tolist():
                warn(
                    f"{self.path or self.name}: {name} of joint {self.joints[j]!r} is "
                    f"{x[j]:g}, which drives the joint; valid is 0 or more"
                )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.as_dict() == other.as_dict()

    def __hash__(self) -> int:
        return hash((self.name, self.joints))

    def __repr__(self) -> str:
        return f"<Robot {self.name}: {', '.join(self.joints)}>"

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names, base to tip."""
        return self.chain.joints

    @property
    def size(self) -> int:
        """Number of joints n."""
        return self.chain.size

    def joint_index(self, joint: str | int) -> int:
        """Index of a joint given by name, or by number from 1 as text.

        Raises:
            RobotError: There is no such joint.
        """
        if joint in self.joints:
            return self.joints.index(str(joint))
        text = str(joint)
        if text.isdigit() and 1 <= int(text) <= self.size:
            return int(text) - 1
        raise RobotError(
            f"no joint {joint!r}; valid are {', '.join(self.joints)}, "
            f"or 1 to {self.size}"
        )

    def joint_torque(self, q: Array, v: Array, a: Array) -> Array:
        """Torque of rotors, springs, ripple and friction, without dry friction, [N·m].

        Position, speed and acceleration have the shape of the torque, (N, n).
        """
        speed = abs(v)
        friction = (self.damping + (self.quadratic + self.cubic * speed) * speed) * v
        bend = np.where(self.knee > 0, self.knee_speed, 1.0)
        friction = friction + self.knee * np.clip(v / bend, -1.0, 1.0)
        spring = self.stiffness * (q - self.springref)
        torque = np.asarray(self.chain.armature * a + friction + spring)
        for joint, sine, cosine, k in self.ripple:
            angle = k * q[:, int(joint)]
            torque[:, int(joint)] += sine * np.sin(angle) + cosine * np.cos(angle)
        for joint, stiffness, rest, knee in self.stiffening:
            bent = q[:, int(joint)] - rest
            torque[:, int(joint)] += stiffness * bent * (1.0 + (bent / knee) ** 2)
        for first, second, inertia, damping, _ in self.coupled:
            pair = [int(first), int(second)]
            both = inertia * a[:, pair].sum(axis=1) + damping * v[:, pair].sum(axis=1)
            torque[:, pair] += both[:, None]
        return torque

    def dry_friction(
        self, v: Array, direction: Callable[[Array], Array] = np.sign
    ) -> Array:
        """Dry friction at some speeds, with Stribeck friction, shape (N, n), [N·m].

        The direction of a speed is its sign by default.
        """
        level = np.tile(self.frictionloss, (len(v), 1))
        for joint, height, speed in self.falling:
            level[:, int(joint)] += height * np.exp(-((v[:, int(joint)] / speed) ** 2))
        friction = level * direction(v)
        for first, second, _, _, dry in self.coupled:
            pair = [int(first), int(second)]
            friction[:, pair] += dry * direction(v[:, pair].sum(axis=1))[:, None]
        return np.asarray(friction)

    def position_slope(self, q: Array) -> Array:
        """Derivative of :meth:`joint_torque` by position, shape (N, n), [N·m/rad]."""
        slope = np.tile(self.stiffness, (len(q), 1))
        for joint, sine, cosine, k in self.ripple:
            angle = k * q[:, int(joint)]
            slope[:, int(joint)] += k * (sine * np.cos(angle) - cosine * np.sin(angle))
        for joint, stiffness, rest, knee in self.stiffening:
            bent = (q[:, int(joint)] - rest) / knee
            slope[:, int(joint)] += stiffness * (1.0 + 3.0 * bent**2)
        return slope

    def with_inertial(self, inertial: Array) -> Robot:
        """Return the arm with other link parameters, shape (n, 10)."""
        return replace(self, chain=replace(self.chain, inertial=np.array(inertial)))

    def pinocchio(self) -> pinocchio.Model:
        """Build a pinocchio model of the arm (every joint has one coordinate).

        Raises:
            HybridError: pinocchio is not installed.
        """
        return pinocchio_model(self)

    def mujoco_spec(self) -> mujoco.MjSpec:
        """Build a MuJoCo spec of the arm from its chain.

        Bodies are named by joint. There is no geometry and there are no actuators.
        """
        return mujoco_spec(self)

    def as_dict(self) -> dict[str, Any]:
        """Content for JSON; infinite limits and undeclared gains are ``None``."""
        return {
            "name": self.name,
            "path": Path(self.path).name,
            "chain": plain(vars(self.chain)),
            **{name: plain(getattr(self, name)) for name in _VECTORS},
            **{name: getattr(self, name).tolist() for name in _ROWS},
            "timestep": None if np.isnan(self.timestep) else self.timestep,
            "held": dict(self.held),
        }

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Robot:
        """Rebuild the arm from :meth:`as_dict`; it is equal to the last bit.

        Raises:
            RobotError: A field is missing or has the wrong shape.
        """
        try:
            chain = dict(content["chain"])
            joints, turning = tuple(chain.pop("joints")), chain.pop("revolute")
            if not all(isinstance(x, bool) for x in turning):
                raise RobotError(f"revolute is {turning}; valid are true and false")
            arrays = {key: _numbers(key, value) for key, value in chain.items()}
            own = {
                name: _numbers(name, content[name], none=none or None)
                for name, none in _VECTORS.items()
                if name not in _LATER or name in content
            }
            own |= {
                name: _numbers(name, content.get(name, [])).reshape(-1, width)
                for name, width in _ROWS.items()
            }
            (step,) = _numbers("timestep", [content["timestep"]], none=np.nan)
            return cls(
                name=content["name"],
                path=Path(content["path"]).name,  # relative to the model's folder
                chain=Chain(joints=joints, revolute=np.array(turning), **arrays),
                timestep=float(step),
                held={str(k): float(x) for k, x in content.get("held", {}).items()},
                **own,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RobotError(f"not a saved robot: {error!r}") from error

    def fingerprint(self) -> str:
        """Short hash of kinematics and joint order, which identifies the arm."""
        digest = hashlib.sha256("|".join(self.joints).encode())
        chain = self.chain
        for values in (chain.rotation, chain.translation, chain.axis, chain.revolute):
            digest.update(np.round(values.astype(float), 9).tobytes())
        return digest.hexdigest()[:16]


def _numbers(name: str, values: Any, *, none: float | None = None) -> Array:
    """Convert lists of numbers to an array; ``none`` replaces ``None``."""
    found = np.array([none if x is None else x for x in values])
    if found.dtype.kind not in "if":
        raise RobotError(f"{name} holds more than numbers")
    return found.astype(float)
