"""The space robot tracked online as an ordinary arm. Nothing here prints."""

from __future__ import annotations

import time

import numpy as np
from separable_effects import Log, fit_effects
from space_robot import OFFLINE, SAMPLES, STEP
from space_robot_arm import SharedFriction, arm
from space_robot_searches import Run, faded

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect, Scale
from hybrid.online import OnlineIdentifier, Sample
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

_FIRST = {"coulomb": 1.0, "static": 1.0, "viscous": 1.0, "velocity": 0.3}


def started(
    robot: Robot, effects: list[Effect], data: tuple[Array, ...]
) -> tuple[list[Effect], Array]:
    """Effects and links (2, 10) by separable least squares on the first samples."""
    q, v, a, tau = (x[:OFFLINE] for x in data)
    motion = Motion(STEP * np.arange(OFFLINE), q, v, a, tau, np.ones(OFFLINE, bool))
    body = RigidBody(robot.chain, motion)
    base = build_problem(robot.chain, ()).base
    log = Log(motion, body, tau, body.columns[:, :, list(base.kept)])
    bounds = {"coulomb": (0.0, 5.0), "static": (0.0, 5.0)}
    fit = fit_effects(effects, [log], scales=[Scale(8, 3)] * 2, bounds=bounds)
    links = base.with_values(fit.separable.others).standard()
    return list(fit.effects), links.reshape(-1, 10)


def track(data: tuple[Array, ...], noise: float, *, offline: bool) -> Run:
    """Track the samples in order.

    Args:
        data: Position, speed, acceleration and torque, shape (55, 2) each.
        noise: Standard deviation of the torque, [N·m].
        offline: Start from separable least squares on the samples that the published
            search starts from, else from half the payload and wrong friction.

    """
    robot, effects = arm(), [SharedFriction((0, 1), _FIRST)]
    q, v, a, tau = data
    first, inertial = 0, robot.chain.inertial
    if offline:
        first = OFFLINE
        effects, inertial = started(robot, effects, data)
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
    seconds, path = 0.0, [_parameters(tracker)]
    for k in range(first, SAMPLES):
        start = time.process_time()
        tracker.update(Sample(STEP * k, q[k], tau[k], v[k], a[k]))
        seconds += time.process_time() - start
        path.append(_parameters(tracker))
    cost = faded(data, path[-1][None], SAMPLES)[0]
    return Run(np.array(path), float(cost), seconds / (SAMPLES - first))


def _parameters(tracker: OnlineIdentifier) -> Array:
    """In the order of ``space_robot.NAMES``, shape (8,)."""
    rows = {p.name: p.value for p in tracker.parameters}
    rigid = [
        rows["Izz_1"] + rows["Izz_2"],
        *(rows[x] for x in ("Izz_2", "mx_2", "my_2")),
    ]
    names = ("coulomb", "static", "velocity", "viscous")
    return np.array([*rigid, *(rows[f"shared_friction.{x}[arm]"] for x in names)])


def with_noise(data: tuple[Array, ...], noise: float, seed: int) -> tuple[Array, ...]:
    """The data with white noise on the torque, [N·m]."""
    rng = np.random.default_rng(seed)
    return *data[:3], data[3] + noise * rng.standard_normal(data[3].shape)
