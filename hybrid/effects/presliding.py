"""Dry friction with presliding (Dahl's model)."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointState, Memory, Port, Quantity, Scalar
from hybrid.signals import Motion

_BEFORE = 0.1  # s of motion assumed before a log, which give the initial state


class Presliding(Effect):
    """Dahl's friction, which builds up over a distance δ after each reversal.

    The state h is the share of the level: dh/dq = (1 − h·sgn v)/δ. It depends on the
    path, not on time. Far from a reversal it is Coulomb friction.
    """

    id = "presliding"
    words = "presliding friction"
    port = Port.DRIVE
    fields = {"level": "friction"}
    memory = ("q", "h")
    becomes = "distance", "lower", "coulomb"
    inexact = {"level": 0.01, "distance": 0.01}  # bristles bend by several laws
    gains = (Quantity("level", "N·m", 0.04, 0.0, 0.3, per=(1, 0)),)
    shapes = (Quantity("distance", "rad", 0.005, 1e-5, 0.2),)
    equation = "τ = F · h, dh/dt = (v − |v| h)/δ"
    source = "Dahl 1976, doi 10.2514/3.61511"
    sentence = "Friction of {joints} builds up over a small angle after each reversal."
    remedy = "Use a Dahl or LuGre friction model at the joint."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 1, 1)."""
        (j,) = self.joints
        h = dahl(motion.q[:, j], motion.v[0, j], self.values["distance"])
        return h[:, None, None]

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """Memory of a joint that has moved for a short time, as in :func:`dahl`."""
        return joints[0].q - joints[0].v * _BEFORE, 0.0

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """The state of :func:`dahl` after one more sample."""
        (before, h), (state,) = memory, joints
        path = (state.q - before) / self.values["distance"]
        decay = np.exp(-np.abs(path))
        h = decay * h + (1.0 - decay) * np.sign(path)
        return [self.values["level"] * h], (state.q, h)

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """One step of the law in time, by the trapezoidal rule."""
        path = state.v * step / self.values["distance"]
        half = 0.5 * np.abs(path)
        return (before * (1.0 - half) + self.values["level"] * path) / (1.0 + half)


def dahl(q: Array, speed: float, distance: float) -> Array:
    """Dahl's state, between −1 and 1, along a path q, exact between samples, (N,).

    The speed is that at the first sample and for a short time before, [rad/s].
    """
    path = np.diff(q, prepend=q[0] - speed * _BEFORE)
    decay = np.exp(-np.abs(path) / distance)
    state = (1.0 - decay) * np.sign(path)
    # Each sample maps the previous state to h ↦ decay · h + state. Composing these maps
    # over 1, 2, 4, … samples takes log₂ N passes instead of a loop over samples.
    span = 1
    while span < len(q):
        state[span:] += decay[span:] * state[:-span]
        decay[span:] *= decay[:-span]
        span *= 2
    return np.asarray(state)
