"""Inertial parameters of a payload, or of a link, that the simulator does not have."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Nominal, Port, Quantity, Scale, Scope, Spec
from hybrid.errors import EffectError
from hybrid.signals import Motion

# Relative standard deviation of a link's mass, centre of mass and radius of gyration,
# and of their products, which are its parameters.
_LINK_STD = 0.15 * np.sqrt([1.0, *[2.0] * 3, *[5.0] * 6])
# Standard deviation of payload parameters over the median mass of the links, 1, m, m²:
# of a body some centimetres from the flange, as grippers are.
_PAYLOAD_STD = (1.0, *[0.05] * 3, *[0.005] * 6)
_LEAST_MASS = 0.1  # kg, smallest median mass
_ROUNDING = 1e-9  # of a moment of inertia


class Payload(Effect):
    """Ten inertial parameters of a payload at the last link, about its frame origin.

    The link is the one that the last of ``joints`` moves. It loads all joints up to
    that one, so ``joints`` always contains all of them.
    """

    id = "payload"
    port = Port.BODY
    told_apart = {"link_inertia": "take off what the arm carries and repeat a motion"}
    scope: ClassVar[Scope] = "arm"
    differentiates = True
    weighed: ClassVar[tuple[str, str] | None] = ("mass", "torque_gain")
    gains = (
        Quantity("mass", "kg", 2.0, 0.0, 50.0),
        Quantity("mx", "kg·m", 0.0, -20.0, 20.0),
        Quantity("my", "kg·m", 0.0, -20.0, 20.0),
        Quantity("mz", "kg·m", 0.2, -20.0, 20.0),
        Quantity("Ixx", "kg·m²", 0.022, 0.0, 20.0),
        Quantity("Ixy", "kg·m²", 0.0, -10.0, 10.0),
        Quantity("Iyy", "kg·m²", 0.022, 0.0, 20.0),
        Quantity("Ixz", "kg·m²", 0.0, -10.0, 10.0),
        Quantity("Iyz", "kg·m²", 0.0, -10.0, 10.0),
        Quantity("Izz", "kg·m²", 0.002, 0.0, 20.0),
    )
    equation = "τ = Y_n(q, v, a) · π_payload"
    source = "Atkeson et al. 1986, doi 10.1177/027836498600500306"
    sentence = "The arm carries a payload that the simulator does not know."
    remedy = "Add the payload's mass, centre of mass and inertia to the last link."

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "joints", tuple(range(max(self.joints) + 1)))

    def prior(self, nominal: Nominal, scale: Scale) -> tuple[Array, Array]:
        """A standard deviation of the median mass of the links."""
        mass = max(float(np.median(nominal.inertial[:, 0])), _LEAST_MASS)
        return np.array(_PAYLOAD_STD) * mass, self.least_gains

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, len(joints), 10)."""
        return body.link_columns(self.joints[-1])[:, self.joints]

    def rigid_change(self, size: int, gravity: Array) -> tuple[Array, Array]:
        """Change of the link's ten parameters; see :meth:`Instant.rigid_change`."""
        change = np.zeros((size, 10))
        change[self.joints[-1]] = self.gain_values
        return change, np.zeros(3)

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Weld a body with these parameters to the link.

        Raises:
            EffectError: Mass or inertia are not physical.
        """
        mass, *rest = self.gain_values
        if mass <= 0:
            raise EffectError(f"{self.id}: mass is {mass:g} kg, above 0 is valid")
        center = np.array(rest[:3]) / mass
        xx, xy, yy, xz, yz, zz = rest[3:]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about -= mass * (center @ center * np.eye(3) - np.outer(center, center))
        low, middle, high = np.linalg.eigvalsh(about)
        if low <= 0 or low + middle < (1 - _ROUNDING) * high:
            raise EffectError(
                f"{self.id}: no body of {mass:g} kg has these moments (about its "
                f"centre {low:.3g}, {middle:.3g}, {high:.3g} kg·m²); valid are mx to "
                "Izz that go with the mass"
            )
        # Without a name, so that a link may have several.
        body = spec.body(names[self.joints[-1]]).add_body()
        body.explicitinertial = True
        body.mass, body.ipos = mass, center
        body.fullinertia = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


class LinkInertia(Payload):
    """Change of one link's ten inertial parameters, about the link's frame origin."""

    id = "link_inertia"
    inborn = True
    told_apart = {}
    weighed = None  # the other links of the file set its scale
    scope = "coupling"
    equation = "τ = Y_k(q, v, a) · Δπ_k"
    sentence = "Mass or inertia of the link at {joints} is not the simulator's."
    remedy = "Correct the link's mass, centre of mass and inertia."

    @classmethod
    def places(cls, size: int) -> Iterator[tuple[int, ...]]:
        """Every link, with all joints up to it."""
        yield from (tuple(range(k + 1)) for k in range(size))

    @property
    def at_joints(self) -> tuple[int, ...]:
        """The joint that moves the link."""
        return self.joints[-1:]

    def prior(self, nominal: Nominal, scale: Scale) -> tuple[Array, Array]:
        """Mass, centre and gyration with a standard deviation of 15 % each."""
        std = _LINK_STD * nominal.size[self.joints[-1]]
        return std, np.full(len(std), -np.inf)
