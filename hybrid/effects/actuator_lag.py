"""First-order lag of the drive torque."""

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointState, Memory, Port, Quantity, Scalar
from hybrid.signals import Motion
from hybrid.signals.filters import lagged


class ActuatorLag(Effect):
    """The delivered torque follows the reported one with a first-order lag.

    A negative time constant means that the log lags instead: the logged torque went
    through a low-pass filter.
    """

    id = "actuator_lag"
    port = Port.DRIVE
    shows_in_motion = True
    differentiates = True
    memory = ("known", "asked", "reported")
    gains = (Quantity("time", "s", 0.005, -0.05, 0.05),)
    equation = "τ_reported = τ + T · dτ/dt"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 5.2"
    sentence = "The torque of {joints} builds up with a lag."
    remedy = "Give the actuator first-order dynamics with the fitted time constant."

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order, dτ_load/dt; see :meth:`Effect.columns`."""
        return np.gradient(body.load[:, self.joints], motion.t, axis=0)[:, :, None]

    def report(self, t: Array, torque: Array) -> Array:
        """The commanded torque, ahead of the delivered one; or the filtered torque."""
        time = self.values["time"]
        if time >= 0:
            slope: Array = np.gradient(torque, t, axis=0)
            return torque + time * slope
        return lagged(torque, step=float(t[1] - t[0]), time=-time)

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """All zero: the first entry says that there is no earlier instant."""
        return (0.0, 0.0, 0.0)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """A lead by the last difference, or the next value of the filter.

        See :meth:`Instant.report_at_instant`.
        """
        (now,), time = torque, self.values["time"]
        known, *past = memory
        started: list[Scalar] = [np.where(known > 0.5, x, now) for x in past]
        before, filtered = started
        if time >= 0:
            filtered = now + time * (now - before) / step
        else:
            share = step / (step - 2.0 * time)
            filtered = filtered + share * (now + before - 2.0 * filtered)
        return [filtered], (1.0, now, filtered)

    @property
    def actuator(self) -> Mapping[str, float]:
        """The drive's time constant; none if the log lags."""
        return {"lag": self.values["time"]} if self.values["time"] > 0 else {}

    def measure(self, t: Array, signals: dict[str, Array]) -> dict[str, Array]:
        """Filter the log, if it lags; a lagging drive logs the commanded torque."""
        return signals if self.values["time"] >= 0 else super().measure(t, signals)
