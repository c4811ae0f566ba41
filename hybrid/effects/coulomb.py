"""Dry friction of constant size."""

from hybrid.effects import JointEffect, Port, Quantity, law_of_fields


class Coulomb(JointEffect):
    """Dry friction: F_c·sgn v."""

    id = "coulomb"
    words = "Coulomb friction"
    usual = True
    port = Port.DRIVE
    fields = {"level": "frictionloss"}
    dry = True
    gains = (Quantity("level", "N·m", 0.04, 0.0, 0.3, per=(1, 0)),)
    equation = "τ = F_c · sgn v"
    source = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    sentence = "Dry friction of {joints} differs from the simulator's."
    remedy = "Set the joint's frictionloss to the fitted level."
    law = law_of_fields(fields)
