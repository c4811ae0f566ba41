"""Nonlinear viscous friction."""

from hybrid.effects import JointEffect, Port, Quantity, law_of_fields


class NonlinearViscous(JointEffect):
    """Quadratic and cubic viscous friction: c₂·v|v| + c₃·v³."""

    id = "nonlinear_viscous"
    words = "nonlinear viscous friction"
    port = Port.DRIVE
    fields = {"quadratic": "quadratic", "cubic": "cubic"}
    gains = (
        Quantity("quadratic", "N·m·s²/rad²", 0.02, -0.5, 0.5, per=(1, -2)),
        Quantity("cubic", "N·m·s³/rad³", 0.005, -0.5, 0.5, per=(1, -3)),
    )
    equation = "τ = c₂ · v|v| + c₃ · v³"
    source = "Simoni et al. 2019, doi 10.1017/S0263574717000509"
    sentence = "Friction of {joints} grows with speed in a curve, not in a line."
    remedy = "Give the joint a speed-dependent friction table instead of one damping."
    law = law_of_fields(fields)
