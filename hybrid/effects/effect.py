"""What every effect is: a law, where it acts, and how it enters a plant and a fit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import EffectError
from hybrid.parameters import Parameter
from hybrid.signals import Motion

if TYPE_CHECKING:
    import mujoco

Array = NDArray[np.float64]
Scope = Literal["joint", "coupling", "arm"]


class Port(StrEnum):
    """Where an effect acts on the way from command to recording."""

    COMMAND = "command"
    DRIVE = "drive"
    TRANSMISSION = "transmission"
    BODY = "body"
    ENVIRONMENT = "environment"
    MEASUREMENT = "measurement"


@dataclass(frozen=True)
class Scale:
    """Size of one joint, in which the usual sizes of effects are stated.

    Attributes:
        torque: Rated torque, [N·m].
        speed: Rated speed, [rad/s].
    """

    torque: float
    speed: float


@dataclass(frozen=True)
class Quantity:
    """A parameter of a law before it has a value.

    Attributes:
        name: Field's standard term.
        unit: SI unit.
        typical: Usual size, in multiples of ``per``.
        lower: Smallest physically plausible value, in multiples of ``per``.
        upper: Largest physically plausible value, in multiples of ``per``.
        per: What the numbers are multiples of: powers of the joint's rated torque and
            speed, e.g. ``(1, -1)`` for torque/speed; ``(0, 0)`` for plain SI.
    """

    name: str
    unit: str
    typical: float
    lower: float
    upper: float
    per: tuple[int, int] = (0, 0)

    def scaled(self, scale: Scale) -> Quantity:
        """The same with numbers in SI units for a joint of this size."""
        size = scale.torque ** self.per[0] * scale.speed ** self.per[1]
        return replace(
            self,
            typical=self.typical * size,
            lower=self.lower * size,
            upper=self.upper * size,
            per=(0, 0),
        )


@dataclass(frozen=True)
class JointState:
    """What a law of one joint may depend on; arrays of one shape.

    Attributes:
        t: Time, [s].
        q: Position, [rad].
        v: Speed, [rad/s].
        a: Acceleration, [rad/s²].
        sign: Direction of motion, −1, 0 or 1. A plant may pass its own idea of it.
        load: Torque transmitted to the link, [N·m].
    """

    t: Array
    q: Array
    v: Array
    a: Array
    sign: Array
    load: Array


class Body(Protocol):
    """Rigid-body quantities along a motion, as far as effects need them."""

    @property
    def load(self) -> Array:
        """Torque transmitted to the links, shape (N, n), [N·m]."""

    def link_columns(self, link: int) -> Array:
        """Torque per inertial parameter of one link, shape (N, n, 10)."""

    def response(self, dq: Array, dv: Array, da: Array) -> Array:
        """Change of rigid torque along a change of motion, shape (N, n), [N·m]."""


@dataclass(frozen=True)
class Effect(ABC):
    """One unmodelled effect at given joints with given values.

    The torque is ``columns(motion, body) @ gain values``: linear in the gains,
    nonlinear in the shapes. Effects that change signals rather than add torque override
    :meth:`observe`, and give their first-order columns for screening.

    Attributes:
        joints: Indices of the joints it acts on: one (scope ``joint``), two or more
            (``coupling``), or all of them (``arm``).
        values: Value of each gain and shape, SI units; a gain left out is 0, a shape
            left out has its usual size.
        std: Standard deviation of the values that were estimated.

    Raises:
        EffectError: A value has no such parameter, is not finite, or a shape is out of
            bounds; or the number of joints does not fit the scope.
    """

    id: ClassVar[str]
    port: ClassVar[Port]
    scope: ClassVar[Scope] = "joint"
    gains: ClassVar[tuple[Quantity, ...]]
    shapes: ClassVar[tuple[Quantity, ...]] = ()
    equation: ClassVar[str]
    source: ClassVar[str]
    sentence: ClassVar[str]
    remedy: ClassVar[str]

    joints: tuple[int, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    std: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {g.name: 0.0 for g in self.gains}
        known |= {s.name: s.typical for s in self.shapes}
        strange = [name for name in self.values if name not in known]
        if strange:
            raise EffectError(
                f"{self.id} has no parameter {', '.join(strange)}; "
                f"valid are {', '.join(known)}"
            )
        values = known | {name: float(x) for name, x in self.values.items()}
        for name, x in values.items():
            if not np.isfinite(x):
                raise EffectError(f"{self.id}: {name} is {x}, not a finite number")
        for s in self.shapes:
            if s.per == (0, 0) and not s.lower <= values[s.name] <= s.upper:
                raise EffectError(
                    f"{self.id}: {s.name} is {values[s.name]:g} {s.unit}, "
                    f"valid is {s.lower:g} to {s.upper:g}"
                )
        object.__setattr__(self, "joints", tuple(int(j) for j in self.joints))
        object.__setattr__(self, "values", values)
        self._check_joints()

    def _check_joints(self) -> None:
        if not self.joints or (self.scope == "joint" and len(self.joints) != 1):
            wanted = "one joint" if self.scope == "joint" else "at least one joint"
            raise EffectError(f"{self.id} acts on {wanted}, not {len(self.joints)}")
        if len(set(self.joints)) < len(self.joints) or min(self.joints) < 0:
            raise EffectError(
                f"{self.id}: joints are {self.joints}, different ones from 0 are valid"
            )

    @classmethod
    def typical(
        cls, joints: Sequence[int], scales: Sequence[Scale], **values: float
    ) -> Self:
        """The effect at its usual size; ``values`` override single parameters.

        Args:
            joints: Joints it acts on.
            scales: Size of every joint of the arm.
            values: Parameters given by the user, SI units.
        """
        scale = scales[joints[-1]]
        usual = {x.name: x.scaled(scale).typical for x in (*cls.gains, *cls.shapes)}
        return cls(tuple(joints), usual | values)

    def at(
        self, values: Mapping[str, float], std: Mapping[str, float] | None = None
    ) -> Self:
        """The same effect with other values (those not named stay)."""
        values = {**self.values, **values}
        return replace(self, values=values, std=dict(std or self.std))

    @property
    def gain_values(self) -> Array:
        """Values of the gains, shape (p,)."""
        return np.array([self.values[g.name] for g in self.gains])

    @property
    def shape_values(self) -> dict[str, float]:
        """Values of the shapes by name."""
        return {s.name: self.values[s.name] for s in self.shapes}

    def parameters(self, scales: Sequence[Scale]) -> tuple[Parameter, ...]:
        """Gains and shapes with units, bounds and standard deviations."""
        scale = scales[self.joints[-1]]
        return tuple(
            Parameter(
                x.name,
                self.values[x.name],
                min(x.lower, self.values[x.name]),
                max(x.upper, self.values[x.name]),
                x.unit,
                self.std.get(x.name, float("nan")),
            )
            for x in (y.scaled(scale) for y in (*self.gains, *self.shapes))
        )

    @abstractmethod
    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque per unit of each gain, at the joints it acts on.

        Args:
            motion: Motion of N samples of the whole arm.
            body: Rigid-body quantities along it.

        Returns:
            Columns, shape (N, len(joints), p), in [N·m per unit of the gain].
        """

    def torque(self, motion: Motion, body: Body) -> Array:
        """Torque of the effect at its joints, shape (N, len(joints)), [N·m]."""
        return self.columns(motion, body) @ self.gain_values

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion as the rigid body made it, from the motion as measured."""
        return motion

    @property
    def reports(self) -> bool:
        """Whether :meth:`report` changes the torque that is logged."""
        return type(self).report is not Effect.report

    def report(self, t: Array, torque: Array) -> Array:
        """What the log shows of torque signals at the effect's joints.

        A linear map; plant, prediction and fit all use it. The gain of an effect with
        one is found by successive linearisation: its columns are those of a further
        change.

        Args:
            t: Time, shape (N,), [s].
            torque: True signals, shape (N, any number), [N·m].
        """
        return torque

    # How a simulated plant realises the effect; each hook is the identity by default.

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Put into a MuJoCo spec what MuJoCo itself can simulate.

        Args:
            spec: Spec of the arm; joint and body of link k share the name ``names[k]``.
            names: Joint names of the arm, base to tip.
        """
        return  # by default nothing

    def deliver(self, torque: Array) -> Array:
        """Torque the drive delivers for a torque it believes to deliver; shape (B,)."""
        return torque

    def measure(self, t: Array, signals: dict[str, Array]) -> dict[str, Array]:
        """Turn true signals ``q``, ``v``, ``tau``, shape (N, n), into measured ones."""
        if not self.reports:
            return signals
        tau, joints = signals["tau"].copy(), list(self.joints)
        tau[:, joints] = self.report(t, tau[:, joints])
        return signals | {"tau": tau}

    def as_dict(self, names: Sequence[str]) -> dict[str, Any]:
        """JSON-ready description; ``names`` are the joint names of the arm."""
        return {
            "effect": self.id,
            "joints": [names[j] for j in self.joints],
            "values": dict(self.values),
            "std": {k: x for k, x in self.std.items() if np.isfinite(x)},
        }


class JointEffect(Effect):
    """A memoryless law of one joint's own state, the same for plant and fit.

    ``dry`` marks laws that oppose motion through its direction: a plant realises them
    as a dry-friction constraint, which sticks, and not as a torque.
    """

    dry: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def law(state: JointState, **shapes: Any) -> Sequence[Array]:
        """Torque per unit of each gain; arrays of the shape of ``state``'s."""

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 1, p)."""
        (j,) = self.joints
        v = motion.v[:, j]
        state = JointState(
            motion.t, motion.q[:, j], v, motion.a[:, j], np.sign(v), body.load[:, j]
        )
        unit = np.ones_like(v)
        laws = [unit * x for x in self.law(state, **self.shape_values)]
        return np.stack(laws, axis=-1)[:, None, :]
