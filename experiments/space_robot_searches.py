"""Searches for the parameters of ``space_robot.py``. Nothing here prints."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution
from space_robot import LOWER, OFFLINE, SAMPLES, UPPER, predicted, rigid_columns

from hybrid.robot.chain import Array
from hybrid.search import minimise
from hybrid.search.adaptive_genetic import AdaptiveGenetic
from hybrid.search.recursive_differential_evolution import (
    RecursiveDifferentialEvolution,
)

FORGETTING, PENALTY = 0.98, 1e-6


@dataclass(frozen=True)
class Run:
    """The best parameters after each recursion, their last cost, seconds per recursion.

    Attributes:
        path: Parameters, shape (34, 8).
        cost: Fading sum of squares at the end, [N²·m²].
        seconds: Processor time of one recursion, [s].
    """

    path: Array
    cost: float
    seconds: float


def recursive_search(
    data: tuple[Array, ...], seed: int, strategy: str, detour: float
) -> Run:
    """Offline start by differential evolution, then 34 recursions."""
    *state, tau = data
    rng = np.random.default_rng(seed)

    def cost(p: Array, k: int) -> Array:
        left = predicted(p, *(x[:k] for x in state)) - tau[:k]
        return np.asarray((left**2).sum(2) @ FORGETTING ** np.arange(k)[::-1])

    first = rng.uniform(LOWER, UPPER, (80, 8))
    start = differential_evolution(
        lambda p: cost(p.T, OFFLINE),
        list(zip(LOWER, UPPER, strict=True)),
        rng=rng,
        strategy=strategy,
        init=first,
        mutation=1.2,
        recombination=0.9,
        tol=0,
        atol=0,
        maxiter=150,
        vectorized=True,
        updating="deferred",
        polish=False,
    )
    search = RecursiveDifferentialEvolution(
        LOWER, UPPER, rng=rng, population=start.population, detour=detour
    )
    R, path, began = PENALTY * np.eye(8), [], 0.0
    for k in range(1, SAMPLES + 1):
        best = start.x if k <= OFFLINE + 1 else search.best.point
        here = [x[k - 1 : k] for x in state]
        tries = np.repeat(best[None], 9, axis=0) + 1e-6 * np.eye(9, 8, -1)
        torque = predicted(tries, *here)[:, 0]  # (9, 2)
        slope = (torque[1:] - torque[0]) / 1e-6
        R = FORGETTING * R + slope @ slope.T
        if k > OFFLINE:
            began = began or time.process_time()
            search.renew(cost(search.population, k))
            search.aim(np.linalg.solve(R, slope @ (tau[k - 1] - torque[0])))
            search.tell(cost(search.ask(), k))
            path.append(search.best.point)
    seconds = (time.process_time() - began) / len(path)
    return Run(np.array(path), float(cost(path[-1][None], SAMPLES)[0]), seconds)


def plain(data: tuple[Array, ...]) -> dict[str, Array]:
    """Least squares with Coulomb and viscous friction only, and a genetic search."""
    q, v, a, tau = data
    columns = np.concatenate(
        [rigid_columns(q, v, a), np.sign(v)[..., None], v[..., None]], 2
    )
    x = np.linalg.lstsq(columns.reshape(-1, 6), tau.ravel(), rcond=None)[0]
    search = AdaptiveGenetic(LOWER, UPPER, rng=np.random.default_rng(0), population=80)
    minimise(search, lambda p: np.sum((predicted(p, q, v, a) - tau) ** 2, (1, 2)), 500)
    squares = np.array([*x[:5], np.nan, np.nan, x[5]])
    return {"least squares, no Stribeck": squares, "genetic": search.best.point}
