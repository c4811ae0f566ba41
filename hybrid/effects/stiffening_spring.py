"""A spring that grows stiffer the farther it is bent."""

from collections.abc import Sequence

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class StiffeningSpring(JointEffect):
    """Duffing's spring: hose or cable package that pulls harder at large angles."""

    id = "stiffening_spring"
    words = "a stiffening spring"
    port = Port.ENVIRONMENT
    becomes = "knee", "upper", "spring"
    gains = (Quantity("stiffness", "N·m/rad", 0.05, 0.0, 2.0, per=(1, 0)),)
    shapes = (
        Quantity("rest", "rad", 0.0, -3.2, 3.2),
        Quantity("knee", "rad", 2.0, 0.3, 20.0),
    )
    equation = "τ = k · d · (1 + d²/κ²), d = q − q₀"
    source = "Kovacic and Brennan 2011, doi 10.1002/9780470977859"
    sentence = "A hose or spring of {joints} grows stiffer the farther it is bent."
    remedy = "Give the joint's spring a stiffness that grows with the angle."

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of stiffness."""
        bent = state.q - shapes["rest"]
        return [bent * (1.0 + (bent / shapes["knee"]) ** 2)]
