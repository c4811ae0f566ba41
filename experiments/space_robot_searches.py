"""Searches for the parameters of ``space_robot.py``. Nothing here prints."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution
from search import minimise
from search.adaptive_genetic import AdaptiveGenetic
from search.particle_swarm import ParticleSwarm
from search.recursive_differential_evolution import (
    RecursiveDifferentialEvolution,
)
from space_robot import LOWER, OFFLINE, SAMPLES, TRUE, UPPER, predicted, rigid_columns

from hybrid.arrays import Array

FORGETTING, PENALTY = 0.98, 1e-6
POPULATION, GENERATIONS = 80, 150  # of the offline start


@dataclass(frozen=True)
class Run:
    """The best parameters after each recursion, their last cost, seconds per recursion.

    Attributes:
        path: Parameters before the first recursion and after each, shape (35, 8).
        cost: Fading sum of squares at the end, [N²·m²].
        seconds: Processor time of one recursion, [s].
    """

    path: Array
    cost: float
    seconds: float

    @property
    def updates(self) -> int:
        """Recursions that ended with other parameters than they began with."""
        changes = np.nan_to_num(np.diff(self.path, axis=0))
        return int(changes.any(axis=1).sum())


def faded(data: tuple[Array, ...], p: Array, k: int) -> Array:
    """Fading sum of squares over the first k samples, shape (P,), of (P, 8)."""
    *state, tau = (x[:k] for x in data)
    left = predicted(p, *state) - tau
    return np.asarray((left**2).sum(2) @ FORGETTING ** np.arange(k)[::-1])


def recursive_search(
    data: tuple[Array, ...], seed: int, strategy: str, detour: float
) -> Run:
    """Offline start by differential evolution, then 34 recursions."""
    *state, tau = data
    rng = np.random.default_rng(seed)
    first = rng.uniform(LOWER, UPPER, (POPULATION, 8))
    start = differential_evolution(
        lambda p: faded(data, p.T, OFFLINE),
        list(zip(LOWER, UPPER, strict=True)),
        rng=rng,
        strategy=strategy,
        init=first,
        mutation=1.2,
        recombination=0.9,
        tol=0,
        atol=0,
        maxiter=GENERATIONS,
        vectorized=True,
        updating="deferred",
        polish=False,
    )
    search = RecursiveDifferentialEvolution(
        LOWER, UPPER, rng=rng, population=start.population, detour=detour
    )
    R, path, began = PENALTY * np.eye(8), [start.x], 0.0
    for k in range(1, SAMPLES + 1):
        best = start.x if k <= OFFLINE + 1 else search.best.point
        here = [x[k - 1 : k] for x in state]
        tries = np.repeat(best[None], 9, axis=0) + 1e-6 * np.eye(9, 8, -1)
        torque = predicted(tries, *here)[:, 0]  # (9, 2)
        slope = (torque[1:] - torque[0]) / 1e-6
        R = FORGETTING * R + slope @ slope.T
        if k > OFFLINE:
            began = began or time.process_time()
            search.renew(faded(data, search.population, k))
            search.aim(np.linalg.solve(R, slope @ (tau[k - 1] - torque[0])))
            search.tell(faded(data, search.ask(), k))
            path.append(search.best.point)
    return _run(data, path, began)


def swarm(data: tuple[Array, ...], seed: int) -> Run:
    """Offline start by a particle swarm as large, then 34 recursions of it."""
    search = ParticleSwarm(
        LOWER, UPPER, rng=np.random.default_rng(seed),
        population=POPULATION, iterations=GENERATIONS,
    )  # fmt: skip
    minimise(search, lambda p: faded(data, p, OFFLINE), GENERATIONS)
    path, began = [search.best.point], time.process_time()
    for k in range(OFFLINE + 1, SAMPLES + 1):
        search.renew(faded(data, search.remembered, k))
        search.tell(faded(data, search.ask(), k))
        path.append(search.best.point)
    return _run(data, path, began)


def swarm_at_once(data: tuple[Array, ...], seed: int, size: int = 8) -> Run:
    """A particle swarm over all samples, with as many evaluations as the others.

    It knows all but the first parameters, ``size`` of them, exactly.
    """
    count = GENERATIONS + 2 * (SAMPLES - OFFLINE)
    search = ParticleSwarm(
        LOWER[:size], UPPER[:size], rng=np.random.default_rng(seed),
        population=POPULATION, iterations=count,
    )  # fmt: skip
    path, began = [], time.process_time()
    for _ in range(count):
        x = search.ask()
        known = np.tile(TRUE[size:], (len(x), 1))
        search.tell(faded(data, np.hstack([x, known]), SAMPLES))
        path.append(np.append(search.best.point, TRUE[size:]))
    return _run(data, path, began)


def recursive_least_squares(data: tuple[Array, ...]) -> Run:
    """Rigid body, Coulomb and viscous friction from no knowledge, without Stribeck."""
    *state, tau = data
    columns = linear_columns(*state)
    R, b, path, began = PENALTY * np.eye(6), np.zeros(6), [], time.process_time()
    for H, y in zip(columns, tau, strict=True):
        R, b = FORGETTING * R + H.T @ H, FORGETTING * b + H.T @ y
        x = np.linalg.solve(R, b)
        path.append(np.array([*x[:5], np.nan, np.nan, x[5]]))
    return _run(data, path[OFFLINE - 1 :], began)


def _run(data: tuple[Array, ...], path: list[Array], began: float) -> Run:
    seconds = (time.process_time() - began) / (len(path) - 1)
    cost = faded(data, path[-1][None], SAMPLES)[0]
    return Run(np.array(path), float(cost), seconds)


def linear_columns(q: Array, v: Array, a: Array) -> Array:
    """Torque per unit of α, β, ε, η, f_c, f_v without a Stribeck effect, (N, 2, 6)."""
    friction = np.sign(v)[..., None], v[..., None]
    return np.concatenate([rigid_columns(q, v, a), *friction], axis=2)


def plain(data: tuple[Array, ...]) -> dict[str, Array]:
    """Least squares with Coulomb and viscous friction only, and a genetic search."""
    q, v, a, tau = data
    columns = linear_columns(q, v, a)
    x = np.linalg.lstsq(columns.reshape(-1, 6), tau.ravel(), rcond=None)[0]
    search = AdaptiveGenetic(LOWER, UPPER, rng=np.random.default_rng(0), population=80)
    minimise(search, lambda p: np.sum((predicted(p, q, v, a) - tau) ** 2, (1, 2)), 500)
    squares = np.array([*x[:5], np.nan, np.nan, x[5]])
    return {"least squares, no Stribeck": squares, "genetic": search.best.point}
