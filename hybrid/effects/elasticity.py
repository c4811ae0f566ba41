"""Elasticity between motor and link."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity, Spec
from hybrid.signals import Motion

_PHASE_STEP = 0.15  # rad of an oscillation in one integration step
_MOST_SUBSTEPS = 8  # in a sample
# Additional damping at the start of a log, relative to critical damping, and its decay
# time in s: the initial oscillation is unknown.
_START_DAMPING, _START_TIME = 0.3, 0.3
_LEAST_STIFFNESS = 0.1  # of the spring, less the effect of gravity
_LEAST_DAMPING = 0.05  # relative to critical damping


class Elasticity(Effect):
    """Spring and damper between motor and link: τ = K(θ − q) + D(θ̇ − q̇).

    The encoder is at the motor. The gain is the compliance 1/K.
    """

    id = "elasticity"
    port = Port.TRANSMISSION
    shows_in_motion = True
    rough = 0.4
    steep = True
    behind = "deflection"
    # Noise of positions is largest at the natural frequency, and looks like damping.
    inexact = {"compliance": 0.05, "damping": 0.5}
    not_in_loop = "its link swings by the load that comes next"
    gains = (Quantity("compliance", "rad/(N·m)", 0.01, 0.0, 0.5, per=(-1, 0)),)
    shapes = (Quantity("damping", "N·m·s/rad", 0.02, 0.0, 1.0, per=(1, -1)),)
    equation = "τ = K (θ − q) + D (dθ/dt − dq/dt)"
    source = "Spong 1987, doi 10.1115/1.3143860"
    sentence = "The gear of {joints} twists under load."
    remedy = "Add a joint spring between motor and link in the simulator."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Change of torque over the compliance, at its value.

        See :meth:`Effect.columns`; shape (N, n, 1). At a compliance up to 0 it is the
        first order, of a link that does not oscillate.
        """
        change = self._twist(motion, body)
        return body.response(self.joints[0], *change)[:, :, None]

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link, which oscillates on its spring."""
        compliance = self.values["compliance"]
        if compliance <= 0:
            return motion
        own = compliance * np.eye(motion.q.shape[1])[self.joints[0]]
        dq, dv, da = self._twist(motion, body)[:, :, None] * own
        return replace(motion, q=motion.q + dq, v=motion.v + dv, a=motion.a + da)

    def frequency(self, body: Body) -> float:
        """See :meth:`Effect.frequency`; of the link, with the motor at rest."""
        inertia = float(np.mean(self._slopes(body)[2]))
        compliance = self.values["compliance"] * max(inertia, 0.0)
        return 1.0 / (2.0 * np.pi * np.sqrt(compliance)) if compliance > 0 else np.inf

    def _slopes(self, body: Body) -> tuple[Array, ...]:
        """Derivatives of the joint's torque by its own q, v and a, shape (N,) each."""
        (j,) = self.joints
        return tuple(slope[:, j] for slope in body.slopes(j))

    def _twist(self, motion: Motion, body: Body) -> Array:
        """Position, speed and acceleration of the deflection per compliance, (3, N).

        The deflection d follows M d̈ + (C + D) ḋ + (G + K) d = −τ_load. M, C and G are
        the derivatives of the joint's torque by its own a, v and q.
        """
        (j,) = self.joints
        compliance, damping = self.values["compliance"], self.values["damping"]
        if compliance <= 0:
            place = -body.load[:, j]
            speed = np.gradient(place, motion.t)
            return np.stack([place, speed, np.gradient(speed, motion.t)])
        h = float(np.median(np.diff(motion.t)))
        # A link without inertia, as some files have it, follows within a sample.
        inertia = max(float(np.mean(self._slopes(body)[2])), h**2 / compliance)
        substeps = np.ceil(h / np.sqrt(inertia * compliance) / _PHASE_STEP)
        count = int(np.clip(substeps, 1, _MOST_SUBSTEPS))
        load, G, C, M = body.between(j, count)
        since = np.arange(len(load)) * (h / count)
        ratio = _START_DAMPING * np.exp(-since / _START_TIME) + _LEAST_DAMPING
        drag = damping + 2 * ratio * np.sqrt(inertia / compliance) + C
        stiff = np.maximum(1.0 / compliance + G, _LEAST_STIFFNESS / compliance)
        signals = np.stack([np.maximum(M, 0.1 * inertia), drag, stiff, load])
        d = _swing(signals, h / count)
        speed = np.gradient(d, h / count)
        mass, drag, stiff, load = signals
        acceleration = -(load + drag * speed + stiff * d) / mass
        return np.stack([d, speed, acceleration])[:, ::count] / compliance

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add a deflection joint after the motor joint, on the same axis."""
        if self.values["compliance"] <= 0:
            return
        spring = self.added_joint(spec, names[self.joints[0]])
        spring.stiffness = np.array([1.0 / self.values["compliance"], 0.0, 0.0])
        spring.damping = np.array([self.values["damping"], 0.0, 0.0])


def _swing(signals: Array, h: float) -> Array:
    """Solve m d̈ + c ḋ + k d = −load from rest under the first load, shape (N,).

    Signals are mass m, damping c, stiffness k and load, shape (4, N), samples a time h
    apart. Newmark's rule of average acceleration is stable for any step (Newmark 1959,
    doi 10.1061/JMCEA3.0000098).
    """
    mass, drag, stiff, load = signals
    inner = slice(1, -1)
    m, c, k = mass[inner] / h**2, drag[inner] / (2 * h), stiff[inner] / 4
    bands = np.zeros((len(load), 3)).T  # Fortran order, which LAPACK does not copy
    bands[0] = 1.0
    # Rows 0 and 1 are the initial conditions.
    bands[0, 2:], bands[1, 1:-1], bands[2, :-2] = m + c + k, 2 * (k - m), m - c + k
    out = -(load[:-2] + 2 * load[inner] + load[2:]) / 4
    start = np.full(2, -load[0] / stiff[0])
    rest = np.concatenate([start, out])[:, None]
    return np.asarray(dtbtrs(bands, rest, uplo="L", overwrite_b=True)[0][:, 0])
