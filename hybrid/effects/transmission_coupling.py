"""Coupling of two joints by a common rotor."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import (
    Body,
    Effect,
    JointState,
    Memory,
    Port,
    Quantity,
    Scalar,
    Spec,
)
from hybrid.errors import EffectError
from hybrid.signals import Motion


class TransmissionCoupling(Effect):
    """One rotor turns with the sum of two joint positions, as in many wrists.

    Its inertia and friction act equally on both joints, in addition to the armature and
    friction of each joint.
    """

    id = "transmission_coupling"
    port = Port.TRANSMISSION
    scope = "coupling"
    gains = (
        Quantity("inertia", "kg·m²", 0.01, 0.0, 0.5, per=(1, -1)),
        Quantity("viscous", "N·m·s/rad", 0.02, 0.0, 1.0, per=(1, -1)),
        Quantity("coulomb", "N·m", 0.02, 0.0, 0.3, per=(1, 0)),
    )
    equation = "τ_i = τ_j = I (a_i + a_j) + F_v (v_i + v_j) + F_c sgn(v_i + v_j)"
    source = "Gautier and Janot, TX40 wrist; doi 10.1109/TCST.2013.2253321"
    sentence = "{joints} are coupled through their gears."
    remedy = "Add the coupled rotor to the transmission model."

    def _check_joints(self) -> None:
        super()._check_joints()
        if len(self.joints) != 2:
            raise EffectError(
                f"{self.id} acts on two joints, not {len(self.joints)}: "
                f"{self.id}:first+second"
            )

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 2, 3)."""
        joints = list(self.joints)
        v, a = motion.v[:, joints].sum(axis=1), motion.a[:, joints].sum(axis=1)
        return np.stack([np.stack([a, v, np.sign(v)], axis=1)] * 2, axis=1)

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """The same law; see :meth:`Instant.at_instant`."""
        v, a = joints[0].v + joints[1].v, joints[0].a + joints[1].a
        inertia, viscous, coulomb = self.gain_values
        torque = inertia * a + viscous * v + coulomb * np.sign(v)
        return [torque, torque], ()

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add a tendon whose length is the sum of both joints.

        Negative values of a fit become 0, because MuJoCo refuses them.
        """
        pair = [names[j] for j in self.joints]
        rotor = spec.add_tendon(name=f"{'+'.join(pair)}/{self.id}")
        for name in pair:
            rotor.wrap_joint(name, 1.0)
        inertia, viscous, coulomb = np.maximum(self.gain_values, 0.0)
        rotor.armature, rotor.frictionloss = inertia, coulomb
        rotor.damping[0] = viscous
