"""Tilt of the base against gravity."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity, Spec
from hybrid.signals import Motion


class GravityTilt(Effect):
    """The base is rotated by small angles about its two horizontal axes.

    In the base frame gravity changes by Δg = g × (roll · e₁ + pitch · e₂). For an arm
    on the floor, e₁ and e₂ are the base's x and y axes.
    """

    id = "gravity_tilt"
    port = Port.BODY
    scope = "arm"
    gains = (
        Quantity("roll", "rad", 0.02, -0.2, 0.2),
        Quantity("pitch", "rad", 0.01, -0.2, 0.2),
    )
    equation = "τ = G(q, g × (α e₁ + β e₂))"
    source = "Hollerbach et al. 2016, doi 10.1007/978-3-319-32552-1_6"
    sentence = "The arm's base is not level."
    remedy = "Level the base, or set the simulator's gravity to the tilted direction."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, n, 2)."""
        turned = [np.cross(body.gravity, axis) for axis in level_axes(body.gravity)]
        return np.stack([body.weight(g) for g in turned], axis=-1)[:, self.joints]

    def rigid_change(self, size: int, gravity: Array) -> tuple[Array, Array]:
        """Rotation of gravity to first order; see :meth:`Instant.rigid_change`."""
        turned = np.cross(gravity, level_axes(gravity))
        return np.zeros((size, 10)), self.gain_values @ turned

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Rotate the spec's gravity by the angle, exactly."""
        spec.option.gravity = self.turned(np.array(spec.option.gravity))

    def turned(self, gravity: Array) -> Array:
        """Gravity in the frame of the tilted base, from that of the level one, (3,)."""
        from scipy.spatial.transform import Rotation

        tilt = Rotation.from_rotvec(self.gain_values @ level_axes(gravity))
        return np.asarray(tilt.inv().apply(gravity))


def level_axes(gravity: Array) -> Array:
    """Two horizontal unit vectors close to the base's own axes, shape (2, 3)."""
    size = np.linalg.norm(gravity)
    down = gravity / size if size > 0 else np.array([0.0, 0.0, -1.0])
    first, _ = np.delete(np.eye(3), np.argmax(np.abs(down)), axis=0)
    first = first - (first @ down) * down
    first /= np.linalg.norm(first)
    second = np.cross(first, down)
    return np.stack([first, second * np.sign(second[np.argmax(np.abs(second))])])
