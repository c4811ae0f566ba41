"""Friction that differs between the two directions."""

from collections.abc import Sequence

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class AsymmetricFriction(JointEffect):
    """Half the difference of forward and backward dry friction: ΔF_c·|sgn v|."""

    id = "asymmetric_friction"
    port = Port.DRIVE
    fields = {"level": "friction"}
    dry = True
    gains = (Quantity("level", "N·m", 0.015, -0.2, 0.2, per=(1, 0)),)
    equation = "τ = ΔF_c · |sgn v|"
    source = "Swevers et al. 1997, doi 10.1109/70.631234"
    sentence = "Friction of {joints} is higher in one direction than in the other."
    remedy = "Give the joint two friction levels, one for each direction."

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per N·m of level."""
        return (abs(state.sign),)
