"""Nonlinear viscous friction."""

from collections.abc import Mapping, Sequence

from hybrid.effects import (
    FASTEST,
    JointEffect,
    JointState,
    Port,
    Quantity,
    Scalar,
    continued,
)


class NonlinearViscous(JointEffect):
    """Quadratic and cubic viscous friction: c₂·v|v| + c₃·v³.

    Beyond ``fastest``, the highest speed in the data, it is its tangent.
    """

    id = "nonlinear_viscous"
    words = "nonlinear viscous friction"
    port = Port.DRIVE
    fields = {"quadratic": "quadratic", "cubic": "cubic"}
    gains = (
        Quantity("quadratic", "N·m·s²/rad²", 0.02, -0.5, 0.5, per=(1, -2)),
        Quantity("cubic", "N·m·s³/rad³", 0.005, -0.5, 0.5, per=(1, -3)),
    )
    shapes = (FASTEST,)
    equation = "τ = c₂ · v|v| + c₃ · v³"
    source = "Simoni et al. 2019, doi 10.1017/S0263574717000509"
    sentence = "Friction of {joints} grows with speed in a curve, not in a line."
    remedy = "Give the joint a speed-dependent friction table instead of one damping."

    @property
    def exact_fields(self) -> Mapping[str, str]:
        """All fields, if it is a polynomial at all speeds."""
        return self.fields if self.values["fastest"] == FASTEST.upper else {}

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of each coefficient."""
        speed = abs(state.v)
        return [state.sign * continued(speed, shapes["fastest"], p) for p in (2, 3)]
