"""Error of the torque constant."""

from collections.abc import Mapping, Sequence

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Memory, Port, Quantity, Scalar
from hybrid.signals import Motion


class TorqueGain(Effect):
    """Reported torque is (1 + g) times the delivered one."""

    id = "torque_gain"
    port = Port.DRIVE
    gains = (Quantity("gain", "", 0.1, -0.5, 0.5),)
    equation = "τ_reported = (1 + g) · τ_delivered"
    source = "Gautier and Briot 2014, doi 10.1115/1.4027506"
    sentence = "The torque constant of {joints} is off."
    remedy = "Calibrate the drive gain with a known payload."

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order: the transmitted torque; see :meth:`Effect.columns`."""
        return body.load[:, self.joints][:, :, None]

    def report(self, t: Array, torque: Array) -> Array:
        """The whole delivered torque, with rotor and friction, times 1 + g."""
        return torque * (1.0 + self.values["gain"])

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """See :meth:`Instant.report_at_instant`."""
        return [(1.0 + self.values["gain"]) * torque[0]], ()

    @property
    def torque_scale(self) -> float:
        """See :attr:`Effect.torque_scale`."""
        return 1.0 + self.values["gain"]

    @property
    def actuator(self) -> Mapping[str, float]:
        """See :attr:`Instant.actuator`."""
        return {"gain": 1.0 / (1.0 + self.values["gain"])}

    def deliver(self, torque: Array) -> Array:
        """Delivered torque for a commanded one."""
        return torque / (1.0 + self.values["gain"])
