"""A temporary contact of the last link."""

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.effects import Body, Effect, Port, Quantity
from hybrid.signals import Motion


class Contact(Effect):
    """The last link pushes against something; force and moment rise and fall.

    Force and moment are those of the arm on its environment, along the axes of the base
    frame; the moment is about the origin of the last link's frame. Their direction is
    constant. They rise and fall linearly, for equal times, which are together the part
    ``rise`` of the duration. Recordings are counted from 0; −1 means all of them, on
    their common clock.
    """

    id = "contact"
    port = Port.ENVIRONMENT
    not_in_loop = "it happened once, during the recording"
    scope = "arm"
    repeats = "recording"
    choices = 10.0
    gains = (
        *(Quantity(f"force_{x}", "N", 10.0, -500.0, 500.0) for x in "xyz"),
        *(Quantity(f"moment_{x}", "N·m", 1.0, -100.0, 100.0) for x in "xyz"),
    )
    shapes = (
        Quantity("start", "s", 1.0, 0.0, 1e9),
        Quantity("duration", "s", 0.5, 0.01, 1e9),
        Quantity("rise", "", 0.0, 0.0, 1.0),
        Quantity("recording", "", -1.0, -1.0, 1e6, whole=True),
    )
    equation = "τ = Jᵀ(q) f w(t) for start ≤ t < start + duration"
    source = "Haddadin et al. 2017, doi 10.1109/TRO.2017.2723903"
    sentence = "The arm touches something for a while."
    remedy = "Clear the path, and record again; or cut that time out of the recording."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, n, 6)."""
        strength = self._strength(motion.t, motion.number)
        return strength[:, None, None] * body.wrench_columns(self.joints[-1])

    def push(self, t: Array, recording: Index) -> Array:
        """Force and moment during the contact, zero otherwise, shape (B, 6)."""
        return self._strength(t, recording)[:, None] * self.gain_values

    def excludes(self, other: Effect) -> bool:
        """See :meth:`Effect.excludes`; the arm touches one thing at a time."""
        if not isinstance(other, Contact):
            return False
        here, there = self.values, other.values
        both = {here["recording"], there["recording"]} - {-1.0}
        latest = max(here["start"], there["start"])
        ends = (x["start"] + x["duration"] for x in (here, there))
        return len(both) < 2 and latest < min(ends)

    def _strength(self, t: Array, recording: Index | int) -> Array:
        """Force over the largest one, shape (N,)."""
        start, duration, rise, own = self.shape_values.values()
        here = (t >= start) & (t < start + duration)
        here = here & ((own == -1.0) | (recording == own))
        if rise == 0.0:
            return here.astype(np.float64)
        edge = np.minimum(t - start, start + duration - t) / duration
        return np.asarray(here * np.clip(2 * edge / rise, 0.0, 1.0))
