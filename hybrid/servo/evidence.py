"""The evidence of an explanation: of parameters that differ from those of the file.

It is the Laplace approximation

    log p = −J(x̂) − ½ log |1 + S H S| − c · (number of parameters)

with J of :mod:`hybrid.servo.problem`, prior standard deviations S, Hessian H of the
likelihood, and the prior odds c of one parameter among some hundred. All other
parameters that no file states exactly may differ from it by 3 % of S, and are
integrated out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array, Mask
from hybrid.servo.drive import NAMES, PLAIN
from hybrid.servo.noise import INEXACT, Noise
from hybrid.servo.problem import Estimate, Problem

COST = 5.0  # nats: prior odds that one parameter, among some hundred, is wrong
_SOFT = np.isin(NAMES, (*PLAIN, "zero"))[:, None]  # no file states them exactly


@dataclass(frozen=True, eq=False)
class Curvature:
    """Second-order expansion of the posterior over P parameters."""

    places: NDArray[np.int_]  # quantity and joint of each, (P, 2)
    slopes: Array  # derivative of the replay errors by each, (P, M, n)
    matrix: Array  # second derivatives, (P, P)
    gradient: Array  # first derivatives, (P,)
    weight: Array  # of every error, (M, n), [1/rad²]
    spread: Array  # prior deviations, (P,)

    @classmethod
    def of(cls, problem: Problem, found: Estimate, noise: Noise) -> Curvature:
        """Expand about an estimate; parameters of resting joints are fixed."""
        moving = ~problem.resting
        wide = replace(found, free=found.free | (_SOFT & moving))
        spread = problem.prior.spread * np.where(found.free, 1.0, INEXACT)
        slopes = problem.slopes(wide)
        matrix, gradient = problem.normal(wide, slopes, noise, spread)
        places, weight = np.argwhere(wide.free), noise.weights(found.errors)
        return cls(places, slopes, matrix, gradient, weight, spread[wide.free])

    def fall(self, own: Mask) -> float:
        """Decrease of the cost when some of the parameters take their optimum."""
        pull = self.gradient[own]
        return float(0.5 * pull @ np.linalg.solve(self.matrix[np.ix_(own, own)], pull))

    def width(self, own: Mask) -> float:
        """½ log |1 + S H S| over some of the parameters."""
        s = self.spread[own]
        scaled = self.matrix[np.ix_(own, own)] * np.outer(s, s)
        return float(0.5 * np.linalg.slogdet(scaled)[1])


def evidence(problem: Problem, found: Estimate, noise: Noise) -> Array:
    """Log evidence of each joint, up to a constant, shape (n,), [nats]."""
    about = Curvature.of(problem, found, noise)
    out = -problem.cost(found, noise) - COST * found.causes.sum(axis=0)
    for j in range(len(out)):
        own = about.places[:, 1] == j
        if own.any():
            out[j] += about.fall(own) - about.width(own)
    return np.asarray(out)
