"""Two joints geared together."""

from __future__ import annotations


import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.signals import Motion


class TransmissionCoupling(Effect):
    """One motor feels the other joint's motion through a shared wrist gear.

    The coupled rotor turns with the sum of both joints, so that each feels the other's
    acceleration and speed, and both feel dry friction of the sum.
    """

    id = "transmission_coupling"
    port = Port.TRANSMISSION
    scope = "coupling"
    gains = (
        Quantity("inertia", "kg·m²", 0.01, 0.0, 0.5, per=(1, -1)),
        Quantity("viscous", "N·m·s/rad", 0.02, 0.0, 1.0, per=(1, -1)),
        Quantity("coulomb", "N·m", 0.02, 0.0, 0.3, per=(1, 0)),
    )
    equation = "τ_i = I a_j + F_v v_j + F_c sgn(v_i + v_j), and likewise for τ_j"
    source = "Gautier and Janot, TX40 wrist; doi 10.1109/TCST.2013.2253321"
    sentence = "{joints} are coupled through their gears."
    remedy = "Add the coupled rotor to the transmission model."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 2, 3)."""
        i, j = self.joints
        other = [j, i]
        both = np.sign(motion.v[:, i] + motion.v[:, j])
        return np.stack(
            [motion.a[:, other], motion.v[:, other], np.stack([both, both], axis=1)],
            axis=-1,
        )
