"""The space robot as an ordinary arm of two links, tracked online. Nothing prints."""

from __future__ import annotations

import time

import numpy as np
from space_robot import OFFLINE, SAMPLES, STEP

from hybrid.dynamics import RigidBody
from hybrid.effects import Effect, JointState, Port, Quantity, Scale
from hybrid.effects.effect import Body
from hybrid.effects.improved_stribeck import ImprovedStribeck
from hybrid.identify.effect_shapes import Log, fit_effects
from hybrid.identify.online import OnlineIdentifier, Sample
from hybrid.identify.problem import build_problem
from hybrid.robot import Robot
from hybrid.robot.chain import Array, Chain
from hybrid.signals import Motion

_LINKS = np.array(
    [[1, 0.5, 0, 0, 0, 0, 0, 0, 0, 1 / 3], [2, 1.5, 0, 0, 0, 0, 0, 0, 0, 2.0]]
)
_FIRST = {"coulomb": 1.0, "static": 1.0, "viscous": 1.0, "velocity": 0.3}


def arm() -> Robot:
    """Two joints about one axis, a metre apart, no gravity; the payload half known."""
    chain = Chain(
        joints=("first", "second"),
        rotation=np.stack([np.eye(3)] * 2),
        translation=np.array([[0.0, 0, 0], [1, 0, 0]]),
        axis=np.array([[0.0, 0, 1]] * 2),
        revolute=np.array([True, True]),
        inertial=_LINKS,
        gravity=np.zeros(3),
        armature=np.zeros(2),
    )
    free, zero = np.full(2, np.inf), np.zeros(2)
    return Robot(
        "space", chain, -free, free, np.full(2, 3.0), np.full(2, 8.0), zero, zero
    )


class SharedFriction(Effect):
    """Stribeck friction with the same four parameters at every joint."""

    id = "shared_friction"
    port = Port.DRIVE
    scope = "arm"
    gains = ImprovedStribeck.gains
    shapes = (Quantity("velocity", "rad/s", 0.1, 0.01, 1.0),)
    equation, source = ImprovedStribeck.equation, ImprovedStribeck.source
    sentence, remedy = ImprovedStribeck.sentence, ImprovedStribeck.remedy

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, n, 3)."""
        load, v = np.zeros_like(motion.v), motion.v
        state = JointState(load, motion.q, v, motion.a, np.sign(v), load)
        velocity = self.values["velocity"]
        laws = ImprovedStribeck.law(state, velocity=velocity, width=0.0)
        return np.stack(laws, axis=-1)


def track(
    data: tuple[Array, ...], noise: float, *, offline: bool
) -> tuple[Array, Array, float]:
    """Track the samples in order.

    Args:
        data: Position, speed, acceleration and torque, shape (55, 2) each.
        noise: Standard deviation of the torque, [N·m].
        offline: Start from separable least squares on the samples that the published
            search starts from, else from half the payload and wrong friction.

    Returns:
        Parameters (8,), their standard deviations, and seconds per sample.
    """
    robot, effects = arm(), [SharedFriction((0, 1), _FIRST)]
    q, v, a, tau = data
    first, inertial = 0, robot.chain.inertial
    if offline:
        first = OFFLINE
        t = STEP * np.arange(first)
        mask = np.ones(first, dtype=bool)
        motion = Motion(t, q[:first], v[:first], a[:first], tau[:first], mask)
        body = RigidBody(robot.chain, motion)
        base = build_problem(robot.chain, ()).base
        log = Log(motion, body, motion.tau, body.columns[:, :, list(base.kept)])
        fit = fit_effects(
            effects,
            [log],
            scales=[Scale(8, 3)] * 2,
            bounds={"coulomb": (0, 5), "static": (0, 5)},
        )
        effects = list(fit.effects)
        known = base.with_values(fit.separable.others).standard()
        inertial = known.reshape(-1, 10)
    tracker = OnlineIdentifier(
        robot,
        effects,
        rate=1 / STEP,
        inertial=inertial,
        cutoff=np.inf,
        memory=1e6,
        prior=0.3 if offline else 1.0,
        shape_prior=0.5,
        standing=np.full(2, 1e-3),
        noise=np.full(2, max(noise, 1e-4)),
    )
    start = time.process_time()
    for k in range(first, SAMPLES):
        tracker.update(Sample(STEP * k, q[k], tau[k], v[k], a[k]))
    seconds = (time.process_time() - start) / (SAMPLES - first)
    rows = {p.name: (p.value, p.std) for p in tracker.parameters}
    inertia, beta = rows["Izz_1"], rows["Izz_2"]
    rigid = [(inertia[0] + beta[0], np.hypot(inertia[1], beta[1])), beta]
    rigid += [rows["mx_2"], rows["my_2"]]
    names = ("coulomb", "static", "velocity", "viscous")
    friction = [rows[f"shared_friction.{x}[arm]"] for x in names]
    found = np.array([*rigid, *friction])
    return found[:, 0], found[:, 1], seconds


def with_noise(data: tuple[Array, ...], noise: float, seed: int) -> tuple[Array, ...]:
    """The data with white noise on the torque, [N·m]."""
    rng = np.random.default_rng(seed)
    return *data[:3], data[3] + noise * rng.standard_normal(data[3].shape)
