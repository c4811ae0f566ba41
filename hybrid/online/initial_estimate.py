"""The unknowns before the first sample: initial values, covariance and bounds."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from hybrid.arrays import Array
from hybrid.effects import Effect, Scale
from hybrid.regression.problem import Problem

REACH = 0.15  # m: usual size of a link, and distance of a payload from the last joint
_LEAST_MASS, _LEAST_MOMENT, _LEAST_INERTIA = 0.1, 0.01, 0.001  # kg, kg·m, kg·m²


@dataclass(frozen=True)
class InitialEstimate:
    """Initial estimate of base parameters, gains and shapes."""

    problem: Problem  # the unknowns, with initial link parameters and effects
    scales: Sequence[Scale]  # rated torque and speed of each joint
    prior: float  # relative standard deviation of link parameters and gains
    shape_prior: float  # relative standard deviation of shapes; 0 keeps them constant

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The effects; gains that are part of base parameters are zero."""
        kept, effects = {x[1:] for x in self.problem.gains}, [*self.problem.effects]
        for e, g in set(self.problem.columns) - kept:
            effects[e] = effects[e].at({effects[e].gains[g].name: 0.0})
        return tuple(effects)

    @cached_property
    def theta(self) -> Array:
        """Initial values, shape (d,)."""
        problem = self.problem
        gains = [problem.effects[e].gain_values[g] for e, g in problem.columns]
        base = problem.base.mapping @ np.concatenate([problem.inertial.ravel(), gains])
        shapes = [x for e in problem.effects for x in e.shape_values.values()]
        return np.concatenate([base, shapes])

    @cached_property
    def root(self) -> Array:
        """Square root of the initial covariance, shape (d, d)."""
        problem, p = self.problem, self.problem.size
        std = self.prior * np.concatenate([self._link_sizes(), self._gain_sizes()])
        directions = problem.base.mapping * std  # (p, 10n + gains)
        upper: Array = np.asarray(np.linalg.qr(directions.T, mode="r"))
        continuous = [not s.whole for e in problem.effects for s in e.shapes]
        shapes = self.shape_prior * np.abs(self.theta[p:]) * continuous
        return np.asarray(block_diag(upper.T, np.diag(shapes)))

    def _link_sizes(self) -> Array:
        """Magnitude of the inertial parameters of every link, shape (10n,)."""
        sizes = []
        for link in self.problem.chain.inertial:
            mass = abs(link[0])
            moment = np.linalg.norm(link[1:4]) + REACH * mass
            inertia = abs(link[[4, 6, 9]]).max() + REACH * moment
            sizes += [max(mass, _LEAST_MASS), *3 * [moment + _LEAST_MOMENT]]
            sizes += 6 * [inertia + _LEAST_INERTIA]
        return np.array(sizes)

    def _gain_sizes(self) -> Array:
        """Magnitude of the gains: their value, or what is usual for the joint."""
        sizes = []
        for e, g in self.problem.columns:
            effect = self.problem.effects[e]
            usual = effect.gains[g].scaled(self.scales[effect.joints[-1]])
            bound = min(usual.upper, abs(usual.lower) or np.inf)
            value = abs(effect.gain_values[g])
            sizes.append(max(value, abs(usual.typical), 0.1 * bound))
        return np.array(sizes)

    def bounds(self) -> tuple[Array, Array]:
        """Physical bounds of the unknowns, shapes (d,)."""
        low, high = [], []
        for effect in self.problem.effects:
            for s in effect.shapes:
                own = s.scaled(self.scales[effect.joints[-1]])
                low.append(min(own.lower, effect.values[s.name]))
                high.append(max(own.upper, effect.values[s.name]))
        most = np.full(self.problem.size, np.inf)
        for unknown, e, g in self.problem.gains:
            effect = self.problem.effects[e]
            own = effect.gains[g].scaled(self.scales[effect.joints[-1]])
            most[unknown] = max(own.upper, 2 * self.theta[unknown])
        return np.append(self.problem.lower, low), np.append(most, high)

    def payload_directions(self, sizes: Array) -> Array:
        """Change of the unknowns by each payload parameter of a size, shape (d, 10)."""
        n, out = self.problem.chain.size, np.zeros((len(self.theta), 10))
        mapping = self.problem.base.mapping[:, 10 * n - 10 : 10 * n]
        out[: self.problem.size] = mapping * sizes
        return out


def payload_sizes(mass: float) -> Array:
    """Usual sizes of the inertial parameters of a payload, shape (10,)."""
    return np.array([mass, *3 * [mass * REACH], *6 * [mass * REACH**2]])
