"""Friction of all joints from one log of the whole arm. Nothing here prints."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from improved_stribeck_law import ImprovedStribeck
from joint_friction_logs import ALL_TRUE, ARM, CUTOFF, RATE, logged
from separable_effects import Log, fit_effects

from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem


def all_joints_at_once(rng: np.random.Generator) -> dict[str, Any]:
    """All joints moving, rigid body unknown: 40 s of random motion, one fit."""
    references = [
        random_fourier(ARM, duration=20.0, rate=RATE, seed=rng, fill=0.5) for _ in "12"
    ]
    motions = [logged(reference.q, rng) for reference in references]
    kept = list(build_problem(ARM.chain, ()).base.kept)
    bodies = [RigidBody(ARM.chain, m) for m in motions]
    logs = [
        Log(m, b, m.tau, rigid=b.columns[:, :, kept])
        for m, b in zip(motions, bodies, strict=True)
    ]
    effects: list[Effect] = []
    for j in range(ARM.size):
        effects += [ImprovedStribeck((j,)), TorqueOffset((j,))]
    bounds = {"velocity": (0.001, 0.1), "width": (0.0, 0.1)}
    start = time.process_time()
    fit = fit_effects(
        effects, logs, scales=joint_scales(ARM), cutoff=CUTOFF, bounds=bounds
    )
    seconds = time.process_time() - start
    order = ("coulomb", "static", "velocity", "viscous", "level", "width")
    ends = fit.interval()
    rows: Any = [
        [ends[2 * j + (name == "level"), name] for name in order]
        for j in range(ARM.size)
    ]
    values = [
        [(a.values | b.values)[name] for name in order]
        for a, b in zip(fit.effects[::2], fit.effects[1::2], strict=True)
    ]
    return {"true": ALL_TRUE, "x": values, "interval": rows, "seconds": seconds}
