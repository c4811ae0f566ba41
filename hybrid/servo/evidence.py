"""An explanation of logs, and its evidence.

An explanation is a set of numbers that differ from the file's. Its evidence is the
Laplace approximation

    log p = −J(x̂) − ½ log |1 + S H S| − c · (how many)

with J of :mod:`hybrid.servo.problem`, prior deviations S, curvature H of the data, and
the odds c of one cause among some hundred places. Laws are never exact: numbers that do
not differ are the file's but for 3 % of S, and are integrated out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import NAMES, PLAIN
from hybrid.servo.noise import Noise
from hybrid.servo.problem import Estimate, Problem

COST = 5.0  # nats: prior odds of one number, among some hundred, to be wrong
SAME = 0.03  # of the prior deviation: closer numbers are the same
_SOFT = np.isin(NAMES, (*PLAIN, "zero"))[:, None]  # no file has them exactly


@dataclass(frozen=True, eq=False)
class Explanation:
    """Servos with some numbers other than the file's.

    Attributes:
        found: Their numbers, and the errors of replays.
        causes: Numbers that differ, shape (len(QUANTITIES), n).
        equals: Numbers that would do as well in place of one: motion does not tell.
        losses: How much evidence is lost with one of them back, [nats]; not yet known
            where it is not there.
    """

    found: Estimate
    causes: NDArray[np.bool_]
    equals: Mapping[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    losses: Mapping[tuple[int, int], float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Curvature:
    """Of the posterior about servos, over P numbers that may differ a little.

    Attributes:
        places: Quantity and joint of each, shape (P, 2).
        slopes: Change of errors by each, shape (P, M, n).
        matrix: Second derivatives, shape (P, P).
        gradient: First derivatives, shape (P,).
        weight: Weight of every error, shape (M, n), [1/rad²].
        spread: Prior deviations, shape (P,).
    """

    places: NDArray[np.int_]
    slopes: Array
    matrix: Array
    gradient: Array
    weight: Array
    spread: Array

    @classmethod
    def of(cls, problem: Problem, found: Estimate, noise: Noise) -> Curvature:
        """About servos at which a search ended; of resting joints nothing differs."""
        moving = ~problem.resting
        wide = replace(found, free=found.free | (_SOFT & moving))
        spread = problem.prior.spread * np.where(found.free, 1.0, SAME)
        slopes = problem.slopes(wide)
        matrix, gradient = problem.normal(wide, slopes, noise, spread)
        places, weight = np.argwhere(wide.free), noise.weights(found.errors)
        return cls(places, slopes, matrix, gradient, weight, spread[wide.free])

    def fall(self, own: NDArray[np.bool_]) -> float:
        """Fall of the cost when some of the numbers go where they like."""
        pull = self.gradient[own]
        return float(0.5 * pull @ np.linalg.solve(self.matrix[np.ix_(own, own)], pull))

    def width(self, own: NDArray[np.bool_]) -> float:
        """½ log |1 + S H S| of some of the numbers."""
        s = self.spread[own]
        scaled = self.matrix[np.ix_(own, own)] * np.outer(s, s)
        return float(0.5 * np.linalg.slogdet(scaled)[1])


def evidence(problem: Problem, what: Explanation, noise: Noise) -> Array:
    """Log evidence of each joint but for a constant, shape (n,), [nats]."""
    about = Curvature.of(problem, what.found, noise)
    out = -problem.cost(what.found, noise) - COST * what.causes.sum(axis=0)
    for j in range(len(out)):
        own = about.places[:, 1] == j
        if own.any():
            out[j] += about.fall(own) - about.width(own)
    return np.asarray(out)
