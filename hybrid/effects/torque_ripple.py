"""Torque that repeats with joint position."""

from collections.abc import Sequence

import numpy as np

from hybrid.effects import FASTEST, JointEffect, JointState, Port, Quantity, Scalar
from hybrid.signals import Motion


class TorqueRipple(JointEffect):
    """Periodic torque of motor cogging or gear teeth: A·sin(k q + φ).

    Above ``fastest``, the highest speed at which a fit could identify it, its amplitude
    falls linearly, to zero at twice that speed.
    """

    id = "torque_ripple"
    port = Port.DRIVE
    repeats = "joint"
    choices = 6.0
    gains = (
        Quantity("sine", "N·m", 0.02, -0.15, 0.15, per=(1, 0)),
        Quantity("cosine", "N·m", 0.0, -0.15, 0.15, per=(1, 0)),
    )
    shapes = (Quantity("periods", "1/turn", 20.0, 1.0, 1000.0, near=0.5), FASTEST)
    equation = "τ = A_s · sin(k q) + A_c · cos(k q)"
    source = "Holtz and Springob 1996, doi 10.1109/28.491472"
    sentence = "The torque of {joints} repeats with position."
    remedy = "Compensate the ripple from a position table, or move faster than it."

    def holds(self, motions: Sequence[Motion]) -> bool:
        """Whether a motion is as long as a period: a shorter one repeats nothing."""
        (j,) = self.joints
        travel = max(float(np.ptp(m.q[:, j])) for m in motions)
        return travel * self.values["periods"] >= 2.0 * np.pi

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per N·m of the sine and of the cosine amplitude."""
        angle = shapes["periods"] * state.q
        fade = 2.0 - abs(state.v) / shapes["fastest"]
        fade = np.minimum(np.maximum(fade, 0.0), 1.0)
        return fade * np.sin(angle), fade * np.cos(angle)
