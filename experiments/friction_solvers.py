"""Friction laws of one joint fitted by separable least squares and by searches.

A law has some of the six parameters of ``joint_friction_logs.NAMES``. Nothing prints.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from improved_stribeck_law import ImprovedStribeck
from joint_friction_logs import improved
from scipy.optimize import differential_evolution
from search import minimise
from search.adaptive_genetic import AdaptiveGenetic
from search.annealed_genetic import AnnealedGenetic
from separable import Problem, fit_separable

from hybrid.arrays import Array
from hybrid.effects import JointState

LAWS = {"Coulomb + viscous": [0, 3], "Stribeck": [0, 1, 2, 3], "improved": [*range(6)]}
# With how often they ask in a generation: for the offspring, and in the inner loop.
SEARCHES = {"genetic": (AdaptiveGenetic, 1), "annealed": (AnnealedGenetic, 11)}
GENERATIONS = 500


def full(law: list[int], x: Array) -> Array:
    """All six parameters, shape (..., 6), from those that a law has."""
    p = np.zeros((*np.shape(x)[:-1], 6))
    p[..., 2] = 1.0  # of no effect without a break-away level of its own
    p[..., law] = x
    if 1 not in law:
        p[..., 1] = p[..., 0]
    return p


def separable(v: Array, y: Array, law: list[int], bounds: Array) -> dict[str, Any]:
    """Our fit; ``bounds`` (2, 6) hold the lower and the upper ones."""
    shapes = [k for k in law if k in (2, 5)]
    gains = [k for k in law if k not in (2, 5)]

    rest = np.zeros_like(v)
    state = JointState(rest, rest, v, rest, np.sign(v), rest)

    def columns(s: Array) -> Array:
        v_s, v_0 = (*s, *(1.0, 0.0)[len(s) :])
        slide, stick, drag = ImprovedStribeck.law(state, velocity=v_s, width=v_0)
        if 1 not in law:
            return np.stack([slide + stick, drag], axis=1)
        return np.stack([slide, stick, drag, rest + 1.0][: len(gains)], axis=1)

    start = time.process_time()
    fit = fit_separable(Problem(columns, y, bounds[:, shapes], bounds[:, gains]))
    seconds = time.process_time() - start
    order = np.argsort(shapes + gains)
    return {
        "x": np.concatenate([fit.shapes, fit.gains])[order],
        "interval": [ends[order] for ends in fit.interval()],
        "squares": fit.squares,
        "evaluations": fit.evaluations,
        "seconds": seconds,
    }


def searched(
    v: Array, y: Array, law: list[int], bounds: Array, seeds: int
) -> dict[str, list[dict[str, Any]]]:
    """The population searches: point, history over generations and time, by solver."""

    def squares(x: Array) -> Array:
        return np.asarray(np.sum((y - improved(v, full(law, x))) ** 2, axis=-1))

    low, high = bounds[:, law]
    found: dict[str, list[dict[str, Any]]] = {}
    for seed in range(seeds):
        for name, (kind, asks) in SEARCHES.items():
            rng, start = np.random.default_rng(seed), time.process_time()
            search = kind(low, high, rng=rng, generations=GENERATIONS)
            history = minimise(search, squares, asks * GENERATIONS)[asks - 1 :: asks]
            run = {"x": search.best.point, "history": history}
            run["seconds"] = time.process_time() - start
            run["evaluations"] = asks * GENERATIONS * search.population
            found.setdefault(name, []).append(run)
    de = differential_evolution(
        lambda x: squares(x.T), list(zip(low, high, strict=True)), rng=0,
        vectorized=True, updating="deferred", polish=False,
    )  # fmt: skip
    run = {"x": de.x, "history": np.array([de.fun])}
    run["evaluations"] = de.nfev * len(de.population)  # counted by population
    found["scipy DE"] = [run]
    return found
