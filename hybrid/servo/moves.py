"""Numbers that promise to explain more, by secants of replays.

Errors are taken to change along the straight line from a replay to one with the number
changed; what else is free or known but roughly makes up for it as far as it can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import NAMES, QUANTITIES
from hybrid.servo.evidence import COST, Curvature
from hybrid.servo.problem import SHARED, Estimate, Problem

_LARGEST = 1.5  # of a probe's change
_WHOLE = ("sign", "ground")  # that a part of the change tells nothing of
_DEEPER = (0.0, 0.01, 0.02)  # m: links are no balls, and touch a little higher or lower


@dataclass(frozen=True)
class Move:
    """A number that may differ, by a secant.

    Attributes:
        k: Quantity.
        j: Joint.
        gain: Of evidence, if all is linear, [nats].
        x: Coordinates where a fit starts, shape (len(QUANTITIES), n).
    """

    k: int
    j: int
    gain: float
    x: Array


def probed(
    problem: Problem, x: Array, open_: NDArray[np.bool_], hint: Array
) -> tuple[list[Array], list[Array]]:
    """Changes of one number at all joints or at one, and what replays miss then.

    Args:
        problem: The logs.
        x: Coordinates about which numbers are changed, shape (len(QUANTITIES), n).
        open_: Numbers that may differ, of that shape.
        hint: Coordinates that may hold, of that shape.

    Returns:
        Changes, of that shape each, and errors, shape (M, n) each, [rad].
    """
    changes = []
    for name, usual in _usual_changes(problem, x, hint).items():
        k = NAMES.index(name)
        for change in usual:
            row = np.where(open_[k] & np.isfinite(change), change, 0.0)
            for own in np.diag(row) if SHARED[k] else [row]:
                if own.any():
                    changes.append(np.zeros_like(x))
                    changes[-1][k] = own
    points = [problem.prior.moved(x + each).coordinates for each in changes]
    return changes, problem.errors(points)


def promising(
    problem: Problem,
    found: Estimate,
    about: Curvature,
    changes: Sequence[Array],
    errors: Sequence[Array],
) -> list[Move]:
    """Numbers that promise a gain by what was probed, each once, the best first."""
    best: dict[tuple[int, int], Move] = {}
    for change, after in zip(changes, errors, strict=True):
        for k, j in np.argwhere(change).tolist():
            move = _move(problem, found, about, after, (k, j, float(change[k, j])))
            if move.gain > max(0.0, best[k, j].gain if (k, j) in best else 0.0):
                best[k, j] = move
    return sorted(best.values(), key=lambda x: -x.gain)


def _move(
    problem: Problem,
    found: Estimate,
    about: Curvature,
    after: Array,
    change: tuple[int, int, float],
) -> Move:
    """What a number promises: errors change along the secant to its probe."""
    (k, j, delta), prior = change, problem.prior
    sign = QUANTITIES[k].name == "sign"
    whole = QUANTITIES[k].name in _WHOLE
    mine = (about.places[:, 1] == j) | SHARED[k]
    others = mine & ~(about.places == (k, j)).all(axis=1)
    seen: slice | list[int] = slice(None) if SHARED[k] else [j]
    secant = after - found.errors
    weighed = (about.weight * secant)[:, seen].ravel()
    cross = about.slopes[others][:, :, seen].reshape(int(others.sum()), -1) @ weighed
    rest = np.linalg.solve(
        about.matrix[np.ix_(others, others)], np.c_[about.gradient[others], cross]
    )
    unit = 0.0 if sign else delta / prior.spread[k, j]
    away = (found.x - prior.coordinates)[k, j] / prior.spread[k, j]
    curve = secant[:, seen].ravel() @ weighed + unit**2 - cross @ rest[:, 1]
    pull = found.errors[:, seen].ravel() @ weighed + unit * away - cross @ rest[:, 0]
    share = 1.0 if whole else float(np.clip(-pull / curve, 0.0, _LARGEST))
    gain = 0.5 * about.gradient[others] @ rest[:, 0] - about.fall(mine)
    gain -= pull * share + 0.5 * curve * share**2 + COST
    gain -= 0.0 if sign else 0.5 * np.log(max(curve / unit**2, 1.0))
    x = found.x.copy()
    x[k, j] += share * delta
    ks, js = about.places[others].T
    step = np.where(found.free[ks, js], problem.step[ks, js], 0.0)
    x[ks, js] += np.clip(-rest[:, 0] - rest[:, 1] * share, -step, step)
    return Move(k, j, float(gain), prior.moved(x).coordinates)


def _usual_changes(problem: Problem, x: Array, hint: Array) -> dict[str, list[Array]]:
    """Changes of every number by which it is probed, in coordinates, each (n,)."""
    spread = problem.prior.spread
    ones = np.ones_like(spread[0])
    rates = [np.abs(np.diff(s.command, axis=0)) / s.step for s in problem.stretches]
    fastest = np.maximum(np.quantile(np.concatenate(rates), 0.98, axis=0), 1e-3)
    command = np.concatenate([s.command for s in problem.stretches])
    out: dict[str, list[Array]] = {}
    for k, each in enumerate(QUANTITIES):
        if each.positive:
            out[each.name] = [0.5 * ones, -0.5 * ones, hint[k] - x[k]]
        else:
            out[each.name] = [spread[k], -spread[k], hint[k] - x[k]]
        if each.least == 0.0:
            out[each.name] = [spread[k], 0.25 * spread[k], hint[k] - x[k]]
    # A limit shows only where it is reached: how far below the file's is not known.
    out["stall"] = [-far * spread[NAMES.index("stall")] for far in (1.0, 2.0, 3.0)]
    out["pace"] = [share / fastest for share in (1.2, 2.0, 4.0)]
    # A stop is no nearer than where any log has been.
    for name, way, place in zip(
        ("lower", "upper"), (-1.0, 1.0), problem.reached, strict=True
    ):
        beyond = (way * command).max(axis=0) > way * place
        out[name] = [np.where(beyond, place - x[NAMES.index(name)], 0.0)]
    ground = problem.touched - x[NAMES.index("ground")]
    out["ground"] = [np.nan_to_num(ground + far) for far in _DEEPER]
    out["mass"] = [0.3 * ones, -0.3 * ones]
    out["sign"] = [-2.0 * ones]
    return out
