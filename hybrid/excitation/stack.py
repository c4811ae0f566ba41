"""Several motions chosen together: one program over all their coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.excitation.path import Trajectory
from hybrid.excitation.program import MotionProgram


@dataclass(frozen=True, eq=False)
class StackProgram:
    """The best set of motions, each of which keeps all limits.

    A motion that is chosen while the others are fixed repairs what they lack. Chosen
    together they share the work, and their common information may be better than any
    order of single choices reaches.

    Attributes:
        motion: Criterion, family and limits of each motion.
        count: Number of motions T.
    """

    motion: MotionProgram
    count: int

    @property
    def margin(self) -> float:
        """Part of every limit that is kept free."""
        return self.motion.margin

    def changed(
        self, *, power: float | None = None, margin: float | None = None
    ) -> StackProgram:
        """See :meth:`~hybrid.excitation.program.MotionProgram.changed`."""
        return replace(self, motion=self.motion.changed(power=power, margin=margin))

    def random(self, rng: np.random.Generator) -> Array:
        """Random motions to start from, shape (T·m·n,)."""
        return np.concatenate([self.motion.random(rng) for _ in range(self.count)])

    def trajectories(self, x: Array) -> tuple[Trajectory, ...]:
        """The motions of a point."""
        return tuple(self.motion.trajectory(part) for part in self._parts(x))

    def objective(self, x: Array) -> tuple[float, Array]:
        """See :class:`~hybrid.excitation.solver.ConstrainedProblem`."""
        motion = self.motion
        paths = [motion.grid.path(motion.coefficients(y)) for y in self._parts(x)]
        matrices = [motion.observation.matrix(path) for path in paths]
        rows = [W.reshape(-1, motion.observation.size) for W in matrices]
        gram = motion.known + np.asarray(sum(W.T @ W for W in rows))
        value, slope = motion.criterion.smooth(gram, motion.power)
        gradients = [
            motion.slope(path, W, slope)
            for path, W in zip(paths, matrices, strict=True)
        ]
        return value, np.concatenate(gradients)

    def conditions(self, x: Array) -> tuple[Array, Array]:
        """See :class:`~hybrid.excitation.solver.ConstrainedProblem`."""
        values, slopes = [], []
        for k, part in enumerate(self._parts(x)):
            value, by = self.motion.conditions(part)
            slope = np.zeros((len(value), self.count, len(part)))
            slope[:, k] = by
            values.append(value)
            slopes.append(slope.reshape(len(value), -1))
        return np.concatenate(values), np.concatenate(slopes)

    def excess(self, x: Array) -> float:
        """See :class:`~hybrid.excitation.solver.ConstrainedProblem`."""
        return max(self.motion.excess(part) for part in self._parts(x))

    def verified(self, x: Array) -> dict[str, float]:
        """Largest excess of each condition over all motions, without the margin."""
        found: dict[str, float] = {}
        for part in self._parts(x):
            for name, excess in self.motion.verified(part).items():
                found[name] = max(excess, found.get(name, -np.inf))
        return found

    def _parts(self, x: Array) -> Array:
        return x.reshape(self.count, -1)
