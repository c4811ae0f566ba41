"""Learners of the third stage, fitted where three stages leave torque, and scored.

Shared by the experiment ``compensators_stage.py``; it prints nothing.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from compensation import kinds_of_motion, load_arm
from compensator_learners import left

from hybrid import simulate
from hybrid.compensator import GaussianMixtureRegression, NetworkRegression, Remainder
from hybrid.identify.data import prepare
from hybrid.identify.identification import MOST_LEARNED, Identification
from hybrid.identify.remainder import fit_remainder, mixture

COLUMNS = (
    "error", "payload", "faster", "nat", "nat, faster", "90 %", "90 %, faster",
    "joints", "train s",
)  # fmt: skip


def perceptron(
    x: Any, y: Any, *, like: Any, validation: Any, **options: Any
) -> Remainder:
    """A small network with two heads."""
    return NetworkRegression.fit(x, y, **options)


def diagonal(
    x: Any, y: Any, *, like: Any, validation: Any, **options: Any
) -> Remainder:
    """A mixture with diagonal covariances."""
    learn = partial(GaussianMixtureRegression.fit, structure="diagonal")
    options |= {"components": like.components} if like else {"validation": validation}
    return learn(x, y, **options)


LEARNERS = {"mixture": mixture, "mixture, diagonal": diagonal, "perceptron": perceptron}


def measure(seed: int) -> list[list[float]]:
    """The columns of the table for each learner."""
    robot, plant = load_arm()
    logs = simulate(plant, trajectories=4, fill=0.6, duration=8.0, seed=seed)
    data = prepare(robot, logs, None)
    terms = Identification(robot, data, "irls", (), False, seed)
    for stage in (terms.plain, terms.bend, terms.ripple):
        stage()
    physical = terms.best.model(robot, data, None)
    rest = data.rest_of_folds(terms.best.problem, terms.best.cross.theta)
    motions, payload = kinds_of_motion(plant, seed)
    rows = []
    for learn in LEARNERS.values():
        start = time.process_time()
        bound = MOST_LEARNED * robot.tau_max
        remainder = fit_remainder(rest, bound=bound, learn=learn, seed=seed).remainder
        spent, row, nats, covered = time.process_time() - start, [], [], []
        plain = rest.rms() ** 2
        for name, unseen in motions.items():
            known = (*physical.effects, payload) if name == "payload" else None
            model = replace(physical, effects=known or physical.effects)
            q, v, tau = left(model, unseen)
            mean, variance = remainder.predict_distribution(q, v)
            row.append(np.mean(_rms(tau - mean) / _rms(tau)))
            variance = np.where(np.isfinite(variance), variance, plain)
            nats.append(_likelihood(tau - mean, variance) - _likelihood(tau, plain))
            own = [part.joint for part in remainder.parts]
            inside = np.abs(tau - mean) < 1.645 * np.sqrt(variance)
            covered.append(inside[:, own].mean() if own else np.nan)
        ends = [nats[0], nats[-1], covered[0], covered[-1]]
        rows.append([*row, *ends, len(own), spent])
    return rows


def _likelihood(error: Any, variance: Any) -> float:
    terms = np.log(2 * np.pi * variance) + error**2 / variance
    return float(-0.5 * terms.mean())


def _rms(x: Any) -> Any:
    return np.sqrt(np.mean(x**2, axis=0))
