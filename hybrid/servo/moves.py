"""Rank the parameters by the evidence that each would add, by linear extrapolation.

Each parameter is changed once. Replay errors are assumed to change linearly between the
two replays, and the other parameters of the joint are adapted by linear least squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.servo.drive import NAMES, QUANTITIES
from hybrid.servo.evidence import COST, Curvature
from hybrid.servo.problem import SHARED, Estimate, Place, Problem, one_by_one

_ALONE = SHARED | np.array([x.alone for x in QUANTITIES])
_LARGEST = 1.5  # largest extrapolation, in changes of a probe
# Not linear, and without effect until it is reached: only the whole change makes sense.
_WHOLE = ("sign", "ground", "lower", "upper")
_DEEPER = (0.0, 0.01, 0.02)  # m: links are no balls and touch higher or lower


@dataclass(frozen=True)
class Move:
    """A parameter that may be wrong, and what its linear fit promises."""

    k: int  # index of the quantity
    j: int  # index of the joint
    gain: float  # evidence gained by the linear fit, [nats]
    x: Array  # coordinates at the linear fit, (len(QUANTITIES), n)


def probed(
    problem: Problem, x: Array, open_: Mask, hint: Array
) -> tuple[list[Array], list[Array]]:
    """Change one quantity at a time, at all joints or at one, and replay.

    Only what is ``open_`` changes. ``hint``, of another fit, is tried as well. All have
    the shape (len(QUANTITIES), n), and the replay errors (M, n), [rad].
    """
    changes = []
    for name, usual in _usual_changes(problem, x, hint).items():
        this = np.array(NAMES)[:, None] == name
        for change in usual:
            wanted = np.where(this & open_ & np.isfinite(change), change, 0.0)
            changes += one_by_one(wanted, _ALONE)
    points = [problem.prior.moved(x + each).coordinates for each in changes]
    return changes, problem.errors(points)


def promising(
    problem: Problem,
    found: Estimate,
    about: Curvature,
    changes: Sequence[Array],
    errors: Sequence[Array],
) -> list[Move]:
    """Parameters with a positive gain, each once, the best first."""
    best: dict[Place, Move] = {}
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
    """Fit one parameter and those of its joint, linear in the change of its probe."""
    (k, j, delta), prior = change, problem.prior
    sign = QUANTITIES[k].name == "sign"
    whole = QUANTITIES[k].name in _WHOLE
    mine = (about.places[:, 1] == j) | SHARED[k]
    others = mine & ~(about.places == (k, j)).all(axis=1)
    seen: slice | list[int] = slice(None) if SHARED[k] else [j]
    secant = after - found.errors
    weighed = (about.weight * secant)[:, seen].ravel()
    cross = about.slopes[others][:, :, seen]
    cross = cross.reshape(len(cross), weighed.size) @ weighed
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
    """Changes of the coordinates to try for every quantity, (n,) each."""
    spread = problem.prior.spread
    ones = np.ones_like(spread[0])
    rates = [np.abs(np.diff(s.command, axis=0)) / s.step for s in problem.stretches]
    fastest = np.maximum(np.quantile(np.concatenate(rates), 0.98, axis=0), 1e-3)
    command = np.concatenate([s.command for s in problem.stretches])
    out: dict[str, list[Array]] = {}
    for k, each in enumerate(QUANTITIES):
        size = 0.5 * ones if each.positive else spread[k]
        other = 0.25 * size if each.least == 0.0 else -size
        out[each.name] = [size, other, hint[k] - x[k]]
    # A limit has no effect until it is reached, so that several values are tried: of
    # one that the file states, since all values far above act alike.
    limited = np.where(problem.prior.unlimited, 0.0, spread[NAMES.index("stall")])
    out["stall"] = [-far * limited for far in (1.0, 2.0, 3.0)]
    out["pace"] = [share / fastest for share in (1.2, 2.0, 4.0)]
    # A stop is not nearer than the farthest position in any log.
    for name, way, place in zip(
        ("lower", "upper"), (-1.0, 1.0), problem.reached, strict=True
    ):
        beyond = (way * command).max(axis=0) > way * place
        out[name] = [np.where(beyond, place - x[NAMES.index(name)], 0.0)]
    ground = problem.touched - x[NAMES.index("ground")]
    out["ground"] = [np.nan_to_num(ground + far) for far in _DEEPER]
    play = NAMES.index("play")
    out["play"] = [QUANTITIES[play].probe * spread[play]]
    out["mass"] = [0.3 * ones, -0.3 * ones]
    out["sign"] = [-2.0 * ones]
    return out
