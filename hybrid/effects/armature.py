"""Inertia of rotor and gear, reflected to the joint."""

from collections.abc import Sequence

from hybrid.effects import JointEffect, Port, Quantity, Spec, law_of_fields


class Armature(JointEffect):
    """Torque that accelerates the rotor: I_r·a."""

    id = "armature"
    usual = True
    inborn = True
    port = Port.DRIVE
    fields = {"inertia": "armature"}
    differentiates = True
    gains = (Quantity("inertia", "kg·m²", 0.02, 0.0, 0.5, per=(1, -1)),)
    equation = "τ = I_r · a"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 7.2"
    sentence = "The rotor of {joints} is heavier or lighter than the simulator says."
    remedy = "Set the joint's armature to rotor inertia times the gear ratio squared."
    law = law_of_fields(fields)

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add the rotor inertia to the joint's armature."""
        spec.joint(names[self.joints[0]]).armature += self.values["inertia"]
