"""Columns of rigid body and effects at one instant, with the slopes of the shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.dynamics import RigidBody
from hybrid.dynamics.sample import SampleRegressor
from hybrid.effects import Effect, JointEffect, JointState
from hybrid.errors import IdentificationError
from hybrid.identify.problem import Problem
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion

_STEP = 1e-4  # relative, for slopes of the shapes


@dataclass(frozen=True)
class _Group:
    """One law at k different joints.

    ``rows`` and ``columns`` say where the law's torque per unit of each gain belongs;
    a gain that is not among the unknowns has column −1.
    """

    kind: type[JointEffect]
    joints: NDArray[np.intp]
    unknowns: NDArray[np.intp]  # (p, k), −1 where a gain is not an unknown
    shapes: NDArray[np.intp]  # (s, k)

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Which gains are unknowns of the fit, shape (p, k)."""
        return self.unknowns >= 0

    def fill(self, out: Array, theta: Array, state: JointState) -> None:
        """Write columns of the gains and slopes of the shapes into ``out`` (n, d)."""
        if not self.kind.shapes:
            laws: Sequence[Array] = self.kind.law(state)
            for law, unknown, known in zip(
                laws, self.unknowns, self.known, strict=True
            ):
                out[self.joints[known], unknown[known]] = np.broadcast_to(
                    law, known.shape
                )[known]
            return
        names = [s.name for s in self.kind.shapes]
        values = theta[self.shapes]  # (s, k)
        tried = np.repeat(values[:, None], 1 + len(names), axis=1)
        steps = _STEP * np.maximum(np.abs(values), _STEP)
        for i in range(len(names)):
            tried[i, 1 + i] += steps[i]
        shapes: dict[str, Any] = dict(zip(names, tried, strict=True))
        unit = np.ones((1 + len(names), len(self.joints)))
        torque = np.zeros_like(unit)
        laws = self.kind.law(state, **shapes)
        for law, unknown, known in zip(laws, self.unknowns, self.known, strict=True):
            per_unit = unit * law
            out[self.joints[known], unknown[known]] = per_unit[0, known]
            torque += np.where(known, theta[unknown], 0.0) * per_unit
        for i in range(len(names)):
            out[self.joints, self.shapes[i]] = (torque[1 + i] - torque[0]) / steps[i]


class SampleColumns:
    """Torque of one instant, linearised in base parameters, gains and shapes.

    The unknowns are those of a :class:`~hybrid.identify.problem.Problem`, then the
    shapes of its effects in order.

    Args:
        robot: The arm.
        problem: Which parameters count.

    Raises:
        IdentificationError: An effect changes signals rather than adds torque.
    """

    def __init__(self, robot: Robot, problem: Problem) -> None:
        self.problem = problem
        for effect in problem.effects:
            if effect.reports or type(effect).observe is not Effect.observe:
                raise IdentificationError(
                    f"{effect.id} changes signals and cannot be tracked sample by "
                    "sample; valid are effects that add torque"
                )
        self._regressor = SampleRegressor(robot)
        kept, rigid = np.array(problem.base.kept), 10 * robot.size
        self._rigid = problem.rigid
        self._kept = kept[kept < rigid]
        unknowns = {(e, g): u for u, e, g in problem.gains}
        first = problem.size
        laws: list[tuple[JointEffect, list[int], list[int]]] = []
        self._general: list[tuple[Effect, list[int], list[int]]] = []
        for e, effect in enumerate(problem.effects):
            own = [unknowns.get((e, g), -1) for g in range(len(effect.gains))]
            shapes = list(range(first, first + len(effect.shapes)))
            first += len(effect.shapes)
            if isinstance(effect, JointEffect):
                laws.append((effect, own, shapes))
            else:
                self._general.append((effect, own, shapes))
        self.size = first
        self._groups = _groups(laws)

    def __call__(
        self, q: Array, v: Array, a: Array, theta: Array, t: float
    ) -> tuple[Array, Array]:
        """Columns at one instant.

        Args:
            q: Position, shape (n,), [rad].
            v: Speed, shape (n,), [rad/s].
            a: Acceleration, shape (n,), [rad/s²].
            theta: Unknowns at which shapes and load are taken, shape (d,).
            t: Time, [s].

        Returns:
            Derivative of the torque by every unknown, shape (n, d): its product with
            the unknowns, the shapes left out, is the torque. And the regressor of the
            last link, shape (n, 10).
        """
        Y = self._regressor(q, v, a)
        out = np.zeros((len(q), self.size))
        out[:, self._rigid] = Y[:, self._kept]
        load = out[:, self._rigid] @ theta[self._rigid]
        sign = np.sign(v)
        for group in self._groups:
            j = group.joints
            state = JointState(np.full(len(j), t), q[j], v[j], a[j], sign[j], load[j])
            group.fill(out, theta, state)
        if self._general:
            self._fill_general(out, theta, one_sample(t, q, v, a))
        return out, Y[:, -10:]

    def _fill_general(self, out: Array, theta: Array, motion: Motion) -> None:
        """Effects that are no law of one joint's own state; slower."""
        body = RigidBody(self.problem.chain, motion, self.problem.inertial)
        for effect, unknowns, at in self._general:
            shapes = dict(zip([s.name for s in effect.shapes], theta[at], strict=True))
            joints, here = list(effect.reaches(len(out))), effect.at(shapes)
            columns = here.columns(motion, body)[0]
            known = [g for g, unknown in enumerate(unknowns) if unknown >= 0]
            gains = np.zeros(len(unknowns))
            for g in known:
                out[joints, unknowns[g]] = columns[:, g]
                gains[g] = theta[unknowns[g]]
            for unknown, (name, x) in zip(at, shapes.items(), strict=True):
                step = -_STEP * max(abs(x), _STEP)
                if x + step < _lowest(effect, name):
                    step = -step
                moved = here.at({name: x + step}).columns(motion, body)[0]
                out[joints, unknown] = (moved - columns) @ gains / step


def one_sample(t: float, q: Array, v: Array, a: Array) -> Motion:
    """A motion of one instant, without torque."""
    mask = np.ones(1, dtype=bool)
    return Motion(np.array([t]), q[None], v[None], a[None], 0 * q[None], mask)


def _lowest(effect: Effect, name: str) -> float:
    return next(s.lower for s in effect.shapes if s.name == name)


def _groups(
    laws: Sequence[tuple[JointEffect, list[int], list[int]]],
) -> list[_Group]:
    """Laws of one kind together, in groups in which no joint occurs twice."""
    found: dict[tuple[str, int], list[tuple[JointEffect, list[int], list[int]]]] = {}
    for kind, alike in groupby(sorted(laws, key=lambda x: x[0].id), lambda x: x[0].id):
        seen: dict[int, int] = {}
        for law in alike:
            (joint,) = law[0].joints
            seen[joint] = seen.get(joint, 0) + 1
            found.setdefault((kind, seen[joint]), []).append(law)
    return [
        _Group(
            kind=type(group[0][0]),
            joints=np.array([law[0].joints[0] for law in group]),
            unknowns=np.array([law[1] for law in group]).T,
            shapes=np.array([law[2] for law in group], dtype=int)
            .reshape(len(group), -1)
            .T,
        )
        for group in found.values()
    ]
