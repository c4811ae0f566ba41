"""Regression columns of rigid body and effects at some instants, in small steps.

Laws of single joints are compiled into one function of plain numbers.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import Law, RigidBody, Tape, regressor_law
from hybrid.effects import Effect, JointEffect, JointState, Memory
from hybrid.errors import HybridError
from hybrid.online.layout import PAYLOAD, RowLayout
from hybrid.regression.problem import Problem
from hybrid.robot import Robot
from hybrid.signals import Motion

_STEP = 1e-4  # relative, for finite differences of the shapes
_Past = tuple[float, Memory]  # time of the last instant, and what is remembered of it
_TOGETHER = 2  # instants in a rigid-body step, which then takes as long as the others


class InstantColumns:
    """Derivatives of the torque by all unknowns at B instants, in ``rows``.

    They have the shape (B, n, columns) of a layout.
    """

    def __init__(
        self, robot: Robot, problem: Problem, layout: RowLayout, instants: int
    ) -> None:
        self._problem, self.layout = problem, layout
        self.rows = np.zeros((instants, *layout.shape))
        self._flat = self.rows.reshape(instants, -1)
        self._find_rigid(robot)
        self._compile_laws()

    def fill(
        self, states: tuple[Array, Array, Array, Array], theta: Array
    ) -> Iterator[None]:
        """Write the derivatives to ``rows``, in steps.

        States are time (B,), [s], position (B, n), [rad], speed and acceleration; the
        unknowns (d,) give shapes and load.
        """
        instants = np.concatenate(states[1:], axis=1).tolist()
        for k, row in enumerate(self._flat):
            row[self._targets] = self._regressor.at(instants[k])
            if k % _TOGETHER == _TOGETHER - 1 or k == len(self._flat) - 1:
                yield
        for row, t, q, v, a in zip(self._flat, *states, strict=True):
            load = (row[self._inertial] * theta[self._base]) @ self._of_joint
            signals = np.concatenate([q, v, a, load, theta[self._unknowns]])
            row[self._places] = self._law.at([t, *signals.tolist()])
            yield
        if self._others:
            motion = Motion(*states, 0 * states[1], np.ones(len(self.rows), dtype=bool))
            body = RigidBody(self._problem.chain, motion, self._problem.inertial)
            for e in self._others:
                self._fill_other(e, motion, body, theta)
            yield

    def _find_rigid(self, robot: Robot) -> None:
        """Find the regressor entries that are needed, and their places in a row."""
        n, layout, links = robot.size, self.layout, len(self._problem.rigid)
        each = [x[x < links] for x in self._problem.support]
        joints = np.repeat(np.arange(n), [len(x) for x in each])
        self._base, self._of_joint = np.concatenate(each), np.eye(n)[joints]
        places = np.arange(self._flat.shape[1]).reshape(layout.shape)
        self._inertial = places[joints, self._base]
        last = np.arange(10 * n**2).reshape(n, n, 10)[:, -1, :PAYLOAD].ravel()
        entries = (*self._problem.link_entries, *last.tolist())
        self._regressor = regressor_law(robot.chain, entries)
        self._targets = np.append(self._inertial, places[:, layout.payload])

    def _compile_laws(self) -> None:
        """Compile derivatives of torque by gains and shapes of laws, and their places.

        Laws that cannot be compiled, and effects of more than one joint, are others.
        """
        tape, layout = Tape(), self.layout
        n, width = layout.shape
        names = ["t", *(f"{x}[{j}]" for x in ("q", "v", "a", "load") for j in range(n))]
        t, *signals = (tape.input(name) for name in names)
        states = [
            JointState(t, q, v, a, np.sign(v), load)
            for q, v, a, load in zip(
                *(signals[k * n : k * n + n] for k in range(4)), strict=True
            )
        ]
        found: dict[tuple[int, int], Any] = {}
        self._others: list[int] = []
        self._past: dict[int, _Past | None] = {}
        for e, effect in enumerate(self._problem.effects):
            try:
                found |= _law_columns(e, effect, states, layout, tape)
            except (HybridError, TypeError, ValueError):
                self._others.append(e)
        self._places = np.array([width * j + u for j, u in found], dtype=int)
        inputs = {x.arguments[0] for x in tape.lines if x.name == "input"}
        marks = [u for u in range(layout.size) if f"theta[{u}]" in inputs]
        self._unknowns = np.array(marks, dtype=int)
        names += [f"theta[{u}]" for u in marks]
        self._law = Law(tape, tuple(found.values()), tuple(names))

    def _fill_other(
        self, e: int, motion: Motion, body: RigidBody, theta: Array
    ) -> None:
        """Write an effect that depends on several joints or on the past; slower."""
        effect, own = self._problem.effects[e], self.layout.gains[e]
        shapes, joints = self.layout.shapes[e], [*effect.reaches(motion.q.shape[1])]
        names, values = [s.name for s in effect.shapes], theta[shapes].tolist()
        here = effect.at(dict(zip(names, values, strict=True)))
        past = self._past.get(e)
        columns, self._past[e] = _columns(here, motion, body, past)
        known = [g for g, unknown in enumerate(own) if unknown >= 0]
        gains = theta[[own[g] for g in known]]
        for g in known:
            self.rows[:, joints, own[g]] = columns[:, :, g]
        if not self.layout.tracked:
            return
        for unknown, x, s in zip(shapes, values, effect.shapes, strict=True):
            step = _STEP * max(abs(x), _STEP)
            step = -step if x - step >= s.lower else step
            moved, _ = _columns(here.at({s.name: x + step}), motion, body, past)
            slope = (moved - columns)[:, :, known] @ gains / step
            self.rows[:, joints, unknown] = slope


def _columns(
    effect: Effect, motion: Motion, body: RigidBody, past: _Past | None
) -> tuple[Array, _Past | None]:
    """Torque per unit of each gain, (B, r, p), and what the effect remembers of it.

    An effect that remembers has one gain, to which its torque is proportional.
    """
    if not effect.memory:
        return effect.columns(motion, body), None
    unit, found = effect.at({g.name: 1.0 for g in effect.gains}), []
    signals = motion.q, motion.v, motion.a, np.sign(motion.v), body.load
    for k, t in enumerate(motion.t.tolist()):
        states = [JointState(t, *(x[k, j] for x in signals)) for j in effect.joints]
        before, memory = past or (t, unit.begin(states))
        torque, memory = unit.at_instant(states, memory, t - before)
        past = t, memory
        found.append(torque)
    return np.array(found)[:, :, None], past


def _law_columns(
    e: int,
    effect: Effect,
    states: Sequence[JointState],
    layout: RowLayout,
    tape: Tape,
) -> dict[tuple[int, int], Any]:
    """Symbolic derivative by each gain and shape, by its joint and unknown."""
    if not isinstance(effect, JointEffect):
        raise HybridError(f"{effect.id} is no law of one joint's own state")
    (joint,) = effect.joints

    def theta(unknown: int) -> Any:
        return tape.input(f"theta[{unknown}]") if unknown >= 0 else 0.0

    gains, slopes = layout.gains[e], layout.shapes[e] if layout.tracked else []
    shapes: dict[str, Any] = dict(effect.shape_values)
    if layout.tracked:
        shapes = dict(zip(shapes, map(theta, slopes), strict=True))
    law = [*effect.law(states[joint], **shapes)]

    def torque(law: Sequence[Any]) -> Any:
        return sum(theta(u) * x for u, x in zip(gains, law, strict=True))

    found = dict(zip(gains, law, strict=True))
    for name, unknown in zip(shapes, slopes, strict=False):
        step = _STEP * np.maximum(abs(shapes[name]), _STEP)
        moved = effect.law(states[joint], **shapes | {name: shapes[name] + step})
        found[unknown] = (torque(moved) - torque(law)) / step
    return {(joint, unknown): x for unknown, x in found.items() if unknown >= 0}
