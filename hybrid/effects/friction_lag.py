"""Viscous friction that follows the speed late."""

from collections.abc import Sequence

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointState, Memory, Port, Quantity, Scalar
from hybrid.signals import Motion
from hybrid.signals.filters import lagged


class FrictionLag(Effect):
    """Frictional lag: viscous friction F·u of a film whose shear u follows the speed.

    A film of oil or grease takes a time T to build up: T·du/dt = v − u. So friction is
    higher while a joint brakes than while it accelerates. Motions that are slow against
    T show no more than a rotor that is lighter by F·T: a drive that subtracts too much
    for its rotor before it reports torque looks the same there. Before a log the speed
    has been that of its first sample.
    """

    id = "friction_lag"
    words = "frictional lag"
    port = Port.DRIVE
    fields = {"coefficient": "friction"}
    memory = ("v", "u")
    becomes = "time", "lower", "viscous"
    gains = (Quantity("coefficient", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, -1)),)
    shapes = (Quantity("time", "s", 0.05, 0.005, 0.5),)
    equation = "τ = F_v · u, T · du/dt = v − u"
    source = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    sentence = "Viscous friction of {joints} follows the speed late."
    remedy = "Let the joint's damping act on its low-pass filtered speed."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 1, 1)."""
        return self._late(motion)[:, None, None]

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """A film that has built up at the present speed."""
        return joints[0].v, joints[0].v

    def remembered(self, motion: Motion) -> Sequence[Array]:
        """See :meth:`Effect.remembered`."""
        return motion.v[:, self.joints[0]], self._late(motion)

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """See :meth:`Effect.at_instant`; the trapezoidal rule."""
        (before, u), v, time = memory, joints[0].v, self.values["time"]
        u = u + step / (2.0 * time + step) * (before + v - 2.0 * u)
        return [self.values["coefficient"] * u], (v, u)

    def _late(self, motion: Motion) -> Array:
        """Shear of the film along a motion, shape (N,), [rad/s]."""
        v, time = motion.v[:, self.joints[0]], self.values["time"]
        return lagged(v, step=1.0 / motion.rate, time=time)
