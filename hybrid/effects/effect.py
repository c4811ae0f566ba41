"""The base class of effects: a law, the place where it acts, and hooks for a fit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, ClassVar, Literal, Self

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.in_plant import InPlant
from hybrid.effects.instant import Instant
from hybrid.effects.quantity import Quantity, Scale
from hybrid.effects.state import Body, Nominal
from hybrid.errors import EffectError
from hybrid.signals import Motion

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
class Effect(InPlant, Instant, ABC):
    """One unmodelled effect at given joints with given values.

    The torque is ``columns(motion, body) @ gain values``. It is linear in the gains,
    except for ``steep`` effects, and nonlinear in the shapes. Effects that change
    signals override :meth:`observe` or :meth:`report`; their columns are of first
    order, for screening, and they add no torque. Effects between command and torque do
    not change the relation of torque and motion: their columns are zero.

    Attributes:
        joints: Indices of its joints: one (scope ``joint``), two or more
            (``coupling``), or all of them (``arm``).
        values: Value of each gain and shape in SI units; missing gains are 0, missing
            shapes have their usual size.
        std: Standard deviation of the estimated values.

    Raises:
        EffectError: A parameter is unknown, a value is not finite, a shape is out of
            bounds, or the number of joints does not fit the scope.
    """

    id: ClassVar[str]
    words: ClassVar[str] = ""  # its name in a sentence, if that is not the id
    port: ClassVar[Port]
    scope: ClassVar[Scope] = "joint"
    gains: ClassVar[tuple[Quantity, ...]]
    shapes: ClassVar[tuple[Quantity, ...]] = ()
    # Whether its columns depend so strongly on the gain that a fit has to scan it.
    steep: ClassVar[bool] = False
    # Whether its torque depends on derivatives of the torque, or on acceleration.
    differentiates: ClassVar[bool] = False
    # Whether it shifts a signal in time. A fit scans the time, as noise biases it.
    shifts: ClassVar[bool] = False
    # Relative standard deviation of values fitted to an exact plant without noise,
    # because the law is an approximation.
    inexact: ClassVar[Mapping[str, float]] = {}
    # Error of its law on an exact plant, as a share of its torque's RMS.
    rough: ClassVar[float] = 0.0
    # Whether most joints have it, so that any fit of an arm begins with it.
    usual: ClassVar[bool] = False
    # Whether an arm has it from the beginning, or never.
    inborn: ClassVar[bool] = False
    # The simpler law that it equals at one end of a shape's range: the shape, the end,
    # and the id of the simpler law, or "" if many laws are equal there.
    becomes: ClassVar[tuple[str, Literal["lower", "upper"], str] | None] = None
    # Whether it is the sum of several simpler laws.
    composite: ClassVar[bool] = False
    # Where it may occur several times, with shapes that are read off the residual: at a
    # joint, with some ``periods`` a turn; or in a recording, with ``start``,
    # ``duration`` and ``recording``.
    repeats: ClassVar[Literal["", "joint", "recording"]] = ""
    # Logarithm of the number of its shapes that differ, where all of them are not
    # fitted at once.
    choices: ClassVar[float | None] = None
    # Whether it is determined by the motion rather than by the torque.
    shows_in_motion: ClassVar[bool] = False
    # Whether it depends on how long the drives have been running.
    warms: ClassVar[bool] = False
    # By id of a law with the same torque on every motion: an experiment that separates
    # the two.
    told_apart: ClassVar[Mapping[str, str]] = {}
    # Its mass, a gain that weighing shows as well, and the id of the law whose gain, if
    # all joints share it, multiplies all gains of this one.
    weighed: ClassVar[tuple[str, str] | None] = None
    # Ids of laws that look like it if the logged torque has another scale.
    at_scale: ClassVar[tuple[str, ...]] = ()
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
        """The effect at its usual size; ``values``, in SI units, override some."""
        scale = scales[joints[-1]]
        usual = {x.name: x.scaled(scale).typical for x in (*cls.gains, *cls.shapes)}
        return cls(tuple(joints), usual | values)

    def at(
        self, values: Mapping[str, float], std: Mapping[str, float] | None = None
    ) -> Self:
        """The same effect with other values; those not named do not change."""
        values = {**self.values, **values}
        return replace(self, values=values, std=dict(std or self.std))

    @property
    def gain_values(self) -> Array:
        """Values of the gains, shape (p,)."""
        return np.array([self.values[g.name] for g in self.gains])

    @property
    def least_gains(self) -> Array:
        """Smallest gains at its shapes, shape (p,).

        They are 0, or −∞ if negative ones are valid. A ratio has the same bound on arms
        of all sizes.
        """
        bounds = [-np.inf if g.unit and g.lower < 0 else g.lower for g in self.gains]
        return np.minimum(bounds, 0.0)

    @property
    def shape_values(self) -> dict[str, float]:
        """Values of the shapes by name."""
        return {s.name: self.values[s.name] for s in self.shapes}

    @classmethod
    def places(cls, size: int) -> Iterator[tuple[int, ...]]:
        """Every tuple of joints that it may act on, on an arm of ``size`` joints."""
        span = {"joint": 1, "coupling": 2, "arm": size}[cls.scope]
        yield from (tuple(range(j, j + span)) for j in range(size - span + 1))

    @property
    def at_joints(self) -> tuple[int, ...]:
        """Joints that a report names for it."""
        return self.joints

    @property
    def unit_joints(self) -> tuple[int, ...]:
        """Joints whose kind its units depend on: none for the whole arm."""
        return () if self.scope == "arm" else self.at_joints

    @classmethod
    def declared(cls, nominal: Nominal) -> Array | None:
        """The parameter of the robot file that it changes, shape (n,), or None."""
        fields = [cls.fields.get(g.name, "") for g in cls.gains]
        return getattr(nominal, fields[0], None) if len(fields) == 1 else None

    def prior(self, nominal: Nominal, scale: Scale) -> tuple[Array, Array]:
        """Prior standard deviation and smallest value of each gain, (p,) each."""
        std = np.array([g.scaled(scale).deviation for g in self.gains])
        known = self.declared(nominal)
        if known is None:
            return std, self.least_gains
        return std, -known[list(self.joints)]  # the file's value may be too large

    def at_limit(self, scale: Scale) -> tuple[Self, str] | None:
        """The effect where it equals a simpler law, see :attr:`becomes`, and its id."""
        if self.becomes is None:
            return None
        name, end, law = self.becomes
        (shape,) = (s for s in self.shapes if s.name == name)
        return self.at({name: getattr(shape.scaled(scale), end)}), law

    @classmethod
    def shapes_along(cls, motions: Sequence[Motion]) -> tuple[Quantity, ...]:
        """Shapes on which its torque along motions depends; only these are fitted."""
        return cls.shapes

    def reaches(self, size: int) -> tuple[int, ...]:
        """The r joints whose torque it changes, of ``size``.

        These are all if it changes the motion of one, and its own otherwise.
        """
        return tuple(range(size)) if self.observes else self.joints

    @abstractmethod
    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque per unit of each gain, [N·m per unit], shape (N, r, p).

        It is that at the r joints of :meth:`reaches`, along a motion of the whole arm.
        """

    def torque(self, motion: Motion, body: Body) -> Array:
        """Torque that it adds at the joints of :meth:`reaches`, (N, r), [N·m]."""
        if self.changes_signals:
            return np.zeros((len(motion.t), len(self.reaches(motion.q.shape[1]))))
        return self.columns(motion, body) @ self.gain_values

    @classmethod
    def suggested(cls, motions: Sequence[Motion], j: int) -> Mapping[str, float]:
        """Start values of all shapes at joint j by name, in addition to a grid, or {}.

        For laws that fit only near their own shapes. The motions have the delivered
        and the commanded torque.
        """
        return {}

    def holds(self, motions: Sequence[Motion]) -> bool:
        """Whether recordings allow its law; if not, it has no torque in a fit to them.

        Args:
            motions: Motions with the delivered and the commanded torque, [N·m].
        """
        return True

    def excludes(self, other: Effect) -> bool:
        """Whether an arm cannot have this and another effect at once."""
        return False

    @property
    def torque_scale(self) -> float:
        """Reported torque over delivered torque, of an effect that reports it so."""
        return 1.0

    @property
    def observes(self) -> bool:
        """Whether :meth:`observe` changes the motion."""
        own = type(self)
        by_state = own.true_state is not Instant.true_state
        return by_state or own.observe is not Effect.observe

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The true motion of the rigid body, from the measured motion.

        Its joint has the :meth:`true_state`, if the effect states one.
        """
        if not self.observes:
            return motion
        j, state = list(self.joints), [motion.q, motion.v, motion.a]
        true = self.true_state(*(x[:, j] for x in state))
        q, v, a = (x.copy() for x in state)
        q[:, j], v[:, j], a[:, j] = true
        return replace(motion, q=q, v=v, a=a)

    def frequency(self, body: Body) -> float:
        """Mean natural frequency along a motion, [Hz]; 0 if it does not oscillate."""
        return 0.0

    @property
    def changes_signals(self) -> bool:
        """Whether it changes the motion or the logged torque, and adds no torque."""
        return self.observes or self.reports

    @property
    def linearised(self) -> bool:
        """Whether its torque is linear only near the present values of its gains."""
        return self.changes_signals and not self.steep

    @property
    def reports(self) -> bool:
        """Whether :meth:`report` changes the torque that is logged."""
        return type(self).report is not Effect.report

    def report(self, t: Array, torque: Array) -> Array:
        """Logged torque for delivered torque at the effect's joints, (N, any number).

        It is linear in the torque, and is used in plant, prediction and fit. The gain
        of such an effect is found by successive linearisation: its columns are the
        derivative by a further change.
        """
        return torque

    def as_reported(self) -> Self:
        """The same effect, fitted to the delivered torque, as a law of the reported."""
        return self

    def measure(self, t: Array, signals: dict[str, Array]) -> dict[str, Array]:
        """Measured signals from the true ``q``, ``v``, ``tau``, shape (N, n) each."""
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
