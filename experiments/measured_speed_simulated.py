"""Errors with a measured speed, over those without, on logs of known motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from measured_speed_arms import motion, plain
from measured_speed_logs import ENCODERS, SPEEDS

from hybrid import Robot, simulate
from hybrid.effects import effects_from_text
from hybrid.plant import Noise
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.signals import central_difference, choose_cutoff


def simulated(robot: Robot, seed: int) -> dict[str, list[list[float]]]:
    """Errors of v, a, τ over those without speed: a row an encoder, for each speed."""
    friction = effects_from_text("coulomb,viscous", robot.joints, joint_scales(robot))
    still = Noise.none(robot.size)
    logs = simulate(robot, friction, trajectories=4, seed=seed, noise=still)
    rng, found = np.random.default_rng(seed), {name: [] for name in SPEEDS}
    torque = Noise.typical(robot)
    noisy = [
        replace(x, tau=torque.apply(x.channels, rate=x.rate, rng=rng)["tau"])
        for x in logs
    ]
    for encoder in ENCODERS.values():
        seen = [replace(x, q=encoder(x, rng), v=None) for x in noisy]
        cutoff = float(np.median([choose_cutoff(x) for x in seen]))
        before = scores(robot, logs, seen, cutoff)
        for name, speed in SPEEDS.items():
            pairs = zip(seen, logs, strict=True)
            fused = [replace(x, v=speed(y, x.q, rng)) for x, y in pairs]
            found[name].append(list(scores(robot, logs, fused, cutoff) / before))
    return found


def scores(
    robot: Robot, true: list[Recording], seen: list[Recording], cutoff: float
) -> np.ndarray:
    """RMS error of v, a, and τ of the last log, which no fit sees, joints alike."""
    motions = [motion(x, 2 * cutoff, "both") for x in seen]
    model, last, log = plain(robot, motions[:-1], cutoff, ()), motions[-1], true[-1]
    a = central_difference(log.v, rate=log.rate)
    pairs = (last.v, log.v), (last.a, a), (model.predict(last), log.tau)
    each = [((x - y)[last.mask].std(axis=0) / y.std(axis=0)).mean() for x, y in pairs]
    return np.array(each)
