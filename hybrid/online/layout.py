"""Layout of the regression rows of all joints in one flat array."""

import numpy as np

from hybrid.arrays import Array
from hybrid.regression.problem import Problem

# Mass and first moments of the last link, which gravity and slow motion show at once.
PAYLOAD = 4
_EXTRA = PAYLOAD + 2


class RowLayout:
    """Places of all values in a flat row.

    For each joint in turn: the derivatives of its torque by the unknowns that change
    it, and by mass and first moments of the last link; its torque; and whether it
    moves. The unknowns are those of the problem, then the shapes of its effects, which
    are constant and have no places unless ``shapes``.

    Attributes:
        gains: Index of each gain among the unknowns, −1 if it is none, by effect.
        shapes: Index of each shape, by effect.
    """

    def __init__(self, problem: Problem, shapes: bool) -> None:
        n, first = problem.chain.size, problem.size
        reached: list[list[int]] = [x.tolist() for x in problem.support]
        unknown = {(e, g): u for u, e, g in problem.gains}
        self.gains: list[list[int]] = []
        self.shapes: list[list[int]] = []
        for e, effect in enumerate(problem.effects):
            own = [*range(first, first + len(effect.shapes))]
            first += len(own)
            gains = range(len(effect.gains))
            self.gains.append([unknown.get((e, g), -1) for g in gains])
            self.shapes.append(own)
            for joint in effect.reaches(n) if shapes else ():
                reached[joint] += own
        self.joint_count, self.size = n, first
        extra = range(-_EXTRA, 0)
        flat = [(i, u) for i, own in enumerate(reached) for u in (*own, *extra)]
        self._place = {x: place for place, x in enumerate(flat)}
        self.joints, self.unknowns = np.array(flat).T
        self._known = np.flatnonzero(self.unknowns >= 0)
        self._at = self.joints[self._known], self.unknowns[self._known]
        behind = np.flatnonzero(self.unknowns < 0).reshape(n, _EXTRA)
        self.payload, self.torque, self.moving = (
            behind[:, :PAYLOAD], behind[:, PAYLOAD], behind[:, PAYLOAD + 1]
        )  # fmt: skip

    def place(self, joint: int, unknown: int) -> int:
        """Place of an unknown in the part of a joint; −1 if it has none."""
        return self._place.get((joint, unknown), -1)

    def derivative(self, row: Array) -> Array:
        """Derivative of every joint's torque by all unknowns, shape (n, d)."""
        out = np.zeros((self.joint_count, self.size))
        out[self._at] = row[self._known]
        return out
