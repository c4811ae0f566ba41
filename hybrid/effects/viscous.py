"""Friction proportional to speed."""

from collections.abc import Sequence

from hybrid.effects import JointEffect, Port, Quantity, Spec, law_of_fields


class Viscous(JointEffect):
    """Viscous friction: F_v·v."""

    id = "viscous"
    words = "viscous friction"
    usual = True
    port = Port.DRIVE
    fields = {"coefficient": "damping"}
    gains = (Quantity("coefficient", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, -1)),)
    equation = "τ = F_v · v"
    source = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    sentence = "Viscous friction of {joints} differs from the simulator's."
    remedy = "Set the joint's damping to the fitted coefficient."
    law = law_of_fields(fields)

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add it to the joint's damping, which is stable for a light link."""
        spec.joint(names[self.joints[0]]).damping[0] += self.values["coefficient"]
