"""Offset of the encoder's zero from that of the robot file."""

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity, Scalar
from hybrid.signals import Motion


class EncoderOffset(Effect):
    """The encoder shows the true position plus a constant: q + δ."""

    id = "encoder_offset"
    port = Port.MEASUREMENT
    gains = (Quantity("offset", "rad", 0.01, -0.2, 0.2),)
    equation = "τ = rigid(q_measured − δ, v, a)"
    source = "Hollerbach et al. 2016, doi 10.1007/978-3-319-32552-1_6"
    sentence = "The encoder of {joints} is not zeroed where the simulator's joint is."
    remedy = "Home the joint again, or put the offset into the joint's reference."

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order, −∂τ/∂q; see :meth:`Effect.columns`; shape (N, n, 1)."""
        return -body.slopes(self.joints[0])[0][:, :, None]

    def true_state(
        self, q: Scalar, v: Scalar, a: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """The state without the offset; see :meth:`Instant.true_state`."""
        return q - self.values["offset"], v, a

    def sense(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Position and speed that the encoder shows."""
        return q + self.values["offset"], v
