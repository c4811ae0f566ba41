"""Stribeck friction, which falls with speed."""

from collections.abc import Sequence

import numpy as np

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class Stribeck(JointEffect):
    """Break-away friction above the Coulomb level: F_s·exp(−|v/v_s|^γ)·sgn v."""

    id = "stribeck"
    words = "Stribeck friction"
    port = Port.DRIVE
    fields = {"level": "friction"}
    dry = True
    becomes = "velocity", "upper", ""
    gains = (Quantity("level", "N·m", 0.03, 0.0, 0.3, per=(1, 0)),)
    shapes = (
        Quantity("velocity", "rad/s", 0.05, 0.001, 1.0),
        Quantity("exponent", "", 2.0, 0.5, 3.0),
    )
    equation = "τ = F_s · exp(−|v/v_s|^γ) · sgn v"
    source = "Bo and Pavelescu 1982, doi 10.1016/0043-1648(82)90156-4"
    sentence = "Friction of {joints} is higher at low speed and falls with speed."
    remedy = (
        "Add Stribeck friction (MuJoCo: lugre of a dcmotor), or run the joint faster."
    )

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per N·m of level."""
        ratio = abs(state.v) / shapes["velocity"]
        return (np.exp(-(ratio ** shapes["exponent"])) * state.sign,)
