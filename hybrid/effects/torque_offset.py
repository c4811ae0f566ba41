"""Constant offset of the reported torque."""

from hybrid.effects import JointEffect, Port, Quantity, law_of_fields


class TorqueOffset(JointEffect):
    """Constant torque: bias of the current sensor, or a brake that drags one way."""

    id = "torque_offset"
    usual = True
    port = Port.DRIVE
    fields = {"level": "preload"}
    told_apart = {
        "asymmetric_friction": "log the torque of {joint} at rest with its brake on "
        "and the drive off: a shifted sensor shows its offset, friction shows none"
    }
    gains = (Quantity("level", "N·m", 0.02, -0.3, 0.3, per=(1, 0)),)
    equation = "τ = c"
    source = "Swevers et al. 1997, doi 10.1109/70.631234"
    sentence = "The reported torque of {joints} is shifted by a constant."
    remedy = "Zero the current sensor with the drive off."
    law = law_of_fields(fields)
