"""Layout of the regression rows of all joints in one array."""

from itertools import pairwise

import numpy as np

from hybrid.regression.problem import Problem

# Mass and first moments of the last link, which gravity and slow motion show at once.
PAYLOAD = 4
TORQUE, MOVING = -2, -1  # the last columns


class RowLayout:
    """Columns of the rows of n joints, in an array of the ``shape`` (n, columns).

    For each joint: the derivatives of its torque by all d unknowns, and by mass and
    first moments of the last link; its torque; and whether it moves. The unknowns are
    those of the problem, then the shapes of its effects, which are constant and have
    derivatives of 0 unless they are ``tracked``.

    Attributes:
        gains: Index of each gain among the unknowns, −1 if it is none, by effect.
        shapes: Index of each shape, by effect.
        size: Number of unknowns d.
        payload: Columns of the derivatives by mass and first moments.
    """

    def __init__(self, problem: Problem, tracked: bool) -> None:
        unknown, effects = {(e, g): u for u, e, g in problem.gains}, problem.effects
        self.gains = [
            [unknown.get((e, g), -1) for g in range(len(effect.gains))]
            for e, effect in enumerate(effects)
        ]
        ends = np.cumsum([problem.size, *(len(e.shapes) for e in effects)]).tolist()
        self.shapes = [[*range(*both)] for both in pairwise(ends)]
        self.size, self.tracked = ends[-1], tracked
        self.payload = slice(self.size, self.size + PAYLOAD)
        self.shape = problem.chain.size, self.size + PAYLOAD + 2
