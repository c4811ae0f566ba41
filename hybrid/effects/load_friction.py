"""Dry friction that grows with the transmitted torque."""

from collections.abc import Sequence

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class LoadFriction(JointEffect):
    """Load-dependent dry friction of a gear: μ·|τ_load|·sgn v."""

    id = "load_friction"
    port = Port.DRIVE
    fields = {"coefficient": "friction"}
    dry = True
    inexact = {"coefficient": 0.01}  # the load is that of the file's masses
    gains = (Quantity("coefficient", "", 0.1, 0.0, 0.6),)
    equation = "τ = μ · |τ_load| · sgn v"
    source = "Wahrburg et al. 2018; Hamon et al. 2010, doi 10.1109/IROS.2010.5649189"
    sentence = "Friction of {joints} grows with the torque it carries."
    remedy = "Model the gear's efficiency: friction proportional to transmitted torque."

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of coefficient."""
        return (abs(state.load) * state.sign,)
