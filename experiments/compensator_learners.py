"""Learners of what physics leaves at a joint, and one protocol to score them.

Shared by the experiments ``compensators*.py``; it prints nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from learners import NetworkRegression, RandomFeatureRegression, SymmetricRegression
from learners.em import fit_structured

from hybrid import DynamicModel, Recording
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.signals import Sampler, motion_from_recording

EVERY, HISTORY = 5, 16  # samples
mixture = partial(fit_gmr, components=12)
structured = partial(fit_structured, components=12)
odd = partial(SymmetricRegression.fit, signs=[1.0, -1.0], parity=-1.0)
LEARNERS: dict[str, tuple[Callable[..., Any], int]] = {
    "mixture, full": (mixture, 1),
    "mixture, 32 components": (partial(mixture, components=32), 1),
    "mixture, diagonal": (partial(structured, structure="diagonal"), 1),
    "mixture, low rank": (partial(structured, structure="low_rank", rank=1), 1),
    "mixture, odd in speed": (partial(odd, learn=mixture), 1),
    "perceptron": (NetworkRegression.fit, 1),
    "temporal convolution": (partial(NetworkRegression.fit, history=HISTORY), HISTORY),
    "random features": (RandomFeatureRegression.fit, 1),
}
COLUMNS = ("error", "nat", "90 %", "train s", "µs alone", "µs batch", "numbers")


def samples(
    model: DynamicModel, logs: list[Recording], joint: int, history: int
) -> tuple[np.ndarray, np.ndarray]:
    """Position and speed of a joint, with their past, and what is left."""
    x, y = [], []
    for log in logs:
        m = motion_from_recording(log, cutoff=model.cutoff)
        sampler = Sampler(m.rate, model.cutoff, EVERY)
        rest = sampler((m.tau - model.predict(m))[:, joint])
        state = np.stack([m.q[:, joint], m.v[:, joint]], axis=1)[::EVERY]
        rows = np.flatnonzero(sampler.keep(m.mask))[HISTORY:]
        past = rows[:, None] - np.arange(history)[::-1]
        x.append(state[past].reshape(len(rows), -1))
        y.append(rest[rows, None])
    return np.concatenate(x), np.concatenate(y)


def left(model: DynamicModel, logs: Any) -> tuple[Any, Any, Any]:
    """Position, speed and torque that a model leaves, of samples of all logs."""
    parts = []
    for log in logs:
        m = motion_from_recording(log, cutoff=model.cutoff)
        sampler = Sampler.for_rate(m.rate, model.cutoff)
        keep, step = sampler.keep(m.mask), sampler.factor
        rest = sampler(m.tau - model.predict(m))
        parts.append([x[keep] for x in (m.q[::step], m.v[::step], rest)])
    return tuple(np.concatenate(x) for x in zip(*parts, strict=True))


def score(learn: Callable[..., Any], train: Any, test: Any) -> list[float]:
    """The columns of the table, one learner at one joint."""
    start = time.process_time()
    model = learn(*train)
    spent = [time.process_time() - start]
    x, y = test
    for rows, repeats in ((x[:1], 30), (x, 3)):
        start = time.process_time()
        for _ in range(repeats):
            mean, variance = model.predict_distribution(rows)
        spent.append(1e6 * (time.process_time() - start) / repeats / len(rows))
    plain = np.mean(train[1] ** 2)
    nats = 0.5 * np.mean(
        np.log(plain) + y**2 / plain - np.log(variance) - (y - mean) ** 2 / variance
    )
    inside = np.mean(np.abs(y - mean) < 1.645 * np.sqrt(variance))
    error = np.sqrt(np.mean((y - mean) ** 2) / np.mean(y**2))
    return [error, nats, inside, *spent, sum(a.size for a in model.arrays().values())]
