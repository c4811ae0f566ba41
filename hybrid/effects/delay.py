"""A time shift between logged torque and position."""

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity
from hybrid.signals import Motion


class Delay(Effect):
    """Reported torque is older than the reported position by T."""

    id = "delay"
    port = Port.MEASUREMENT
    shows_in_motion = True
    differentiates = True
    shifts = True
    # The parameters of the file, from which the shifted torque is made, are inexact.
    inexact = {"time": 0.03}
    not_in_loop = "it is of the log's clocks; a drive needs its torque now"
    gains = (Quantity("time", "s", 0.005, -0.05, 0.05),)
    equation = "τ_reported(t) = τ(t − T)"
    source = "Janot et al. 2014, doi 10.1109/TCST.2013.2253321"
    sentence = "Torque and position of {joints} are logged on shifted clocks."
    remedy = "Shift the torque channel by the fitted time, or fix the logger's stamps."

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order, −dτ_load/dt; see :meth:`Effect.columns`."""
        slope = np.gradient(body.load[:, self.joints], motion.t, axis=0)
        return -slope[:, :, None]

    def report(self, t: Array, torque: Array) -> Array:
        """The torque at an earlier time; constant before the first sample."""
        late = t - self.values["time"]
        return np.stack([np.interp(late, t, x) for x in torque.T], axis=1)
