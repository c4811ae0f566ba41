"""A linear spring at a joint: hose, cable or counterbalance."""

from hybrid.effects import JointEffect, Port, Quantity, law_of_fields


class Spring(JointEffect):
    """Linear spring: k·q − k·q₀, with the preload −k·q₀ as a gain of its own."""

    id = "spring"
    port = Port.ENVIRONMENT
    fields = {"stiffness": "stiffness", "preload": "preload"}
    gains = (
        Quantity("stiffness", "N·m/rad", 0.05, -2.0, 2.0, per=(1, 0)),
        Quantity("preload", "N·m", 0.0, -2.0, 2.0, per=(1, 0)),
    )
    equation = "τ = k · q + c"
    source = "Hollerbach et al. 2016, doi 10.1007/978-3-319-32552-1_6"
    sentence = "A spring, hose or counterbalance pulls on {joints}."
    remedy = "Add a joint spring, or the counterbalance's geometry, to the simulator."
    law = law_of_fields(fields)
