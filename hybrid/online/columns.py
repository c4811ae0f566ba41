"""Regression columns of rigid body and effects at some instants, in small steps."""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, regressor_law
from hybrid.online.laws import STEP, InstantLaws
from hybrid.online.layout import PAYLOAD, RowLayout
from hybrid.regression.problem import Problem
from hybrid.robot import Robot
from hybrid.signals import Motion

_TOGETHER = 2  # instants in a rigid-body step, which then takes as long as the others


class InstantColumns:
    """Derivatives of the torque by all unknowns at B instants, in ``rows`` (B, P)."""

    def __init__(
        self, robot: Robot, problem: Problem, layout: RowLayout, instants: int
    ) -> None:
        self._problem, self.layout = problem, layout
        self.rows = np.zeros((instants, len(layout.joints)))
        self._find_rigid(robot)
        self._laws = InstantLaws(problem.effects, layout)

    def fill(
        self, states: tuple[Array, Array, Array, Array], theta: Array
    ) -> Iterator[None]:
        """Write the derivatives to ``rows``, in steps.

        States are time (B,), [s], position (B, n), [rad], speed and acceleration; the
        unknowns (d,) give shapes and load.
        """
        instants = np.concatenate(states[1:], axis=1).tolist()
        for k, row in enumerate(self.rows):
            row[self._targets] = self._regressor.at(instants[k])
            if k % _TOGETHER == _TOGETHER - 1 or k == len(self.rows) - 1:
                yield
        laws = self._laws
        for row, t, q, v, a in zip(self.rows, *states, strict=True):
            load = (row[self._inertial] * theta[self._base]) @ self._of_joint
            row[laws.places] = laws(t, q, v, a, load, theta)
            yield
        if laws.others:
            motion = Motion(*states, 0 * states[1], np.ones(len(self.rows), dtype=bool))
            body = RigidBody(self._problem.chain, motion, self._problem.inertial)
            for e in laws.others:
                self._fill_other(e, motion, body, theta)
            yield

    def _find_rigid(self, robot: Robot) -> None:
        """Find the regressor entries that are needed, and their places in a row."""
        n, layout, kept = robot.size, self.layout, np.array(self._problem.base.kept)
        inertial = np.flatnonzero(np.isin(layout.unknowns, self._problem.rigid))
        joints, self._base = layout.joints[inertial], layout.unknowns[inertial]
        self._inertial, self._of_joint = inertial, np.eye(n)[joints]
        last = 10 * n - 10 + np.arange(PAYLOAD)
        columns = np.concatenate([kept[self._base], np.tile(last, n)])
        rows = np.concatenate([joints, np.repeat(np.arange(n), PAYLOAD)])
        entries = np.ravel_multi_index((rows, columns), (n, 10 * n)).tolist()
        self._regressor = regressor_law(robot.chain, tuple(entries))
        self._targets = np.concatenate([inertial, layout.payload.ravel()])

    def _fill_other(
        self, e: int, motion: Motion, body: RigidBody, theta: Array
    ) -> None:
        """Write an effect that depends on several joints; slower."""
        effect, own = self._problem.effects[e], self.layout.gains[e]
        shapes, joints = self.layout.shapes[e], effect.reaches(motion.q.shape[1])
        names, values = [s.name for s in effect.shapes], theta[shapes].tolist()
        here = effect.at(dict(zip(names, values, strict=True)))
        columns = here.columns(motion, body)  # (B, r, p)
        known = [g for g, unknown in enumerate(own) if unknown >= 0]
        gains = theta[[own[g] for g in known]]

        def write(unknown: int, torque: Array) -> None:
            for joint, x in zip(joints, torque.T, strict=True):
                place = self.layout.place(joint, unknown)
                if place >= 0:
                    self.rows[:, place] = x

        for g in known:
            write(own[g], columns[:, :, g])
        for unknown, x, s in zip(shapes, values, effect.shapes, strict=True):
            if self.layout.place(joints[0], unknown) >= 0:
                step = STEP * max(abs(x), STEP)
                step = -step if x - step >= s.lower else step
                moved = here.at({s.name: x + step}).columns(motion, body)
                write(unknown, (moved - columns)[:, :, known] @ gains / step)
