"""Laws of many joints and trajectories, evaluated together at each step."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.effects import Effect, JointEffect, JointState, Memory, Port
from hybrid.plant.arm import has_hook, overrides

Side = Literal["dry", "drive", "link"]


@dataclass(frozen=True)
class _Group:
    """One law at some of n joints, evaluated at all of them.

    A law of arrays takes no longer at all joints than at some of them, whose states
    would have to be picked.
    """

    law: Callable[..., Sequence[Array]]
    side: Side
    here: Mask  # whether a joint has the law, (n,)
    gains: tuple[Array | None, ...]  # (n,) each, None where all are zero
    shapes: dict[str, Array]  # (n,) each

    def add(self, total: Array, state: JointState) -> None:
        """Add the group's torque to a total, shape (B, n), [N·m]."""
        if self.side == "dry" and "width" in self.shapes:
            # A width smooths the sign for a fit. The constraint solver simulates
            # sticking, and needs the level at the width down to standstill.
            speed = np.maximum(np.abs(state.v), self.shapes["width"])
            state = replace(state, v=state.sign * speed)
        terms = self.law(state, **self.shapes)
        for gain, term in zip(self.gains, terms, strict=True):
            if gain is not None:
                zero = np.zeros_like(total)  # elsewhere, even if the term is infinite
                total += np.multiply(gain, term, out=zero, where=self.here)


class Laws:
    """The summed laws of an arm of n joints along B trajectories.

    Attributes:
        dry: Torque of dry friction in the direction of motion, shape (B, n), [N·m].
        drive: Other torque of the drives, shape (B, n), [N·m].
        link: Torque of the environment on the links, shape (B, n), [N·m].
        resisting: Effects of the drives that remember their torque.
        resisted: Their torque at the last step, shape (B, k) each, [N·m].
        remembering: Effects of the drives that remember something else.
        remembered: Their memory of the last step, (B, 1) each value; None at first.
    """

    def __init__(self, effects: Sequence[Effect], batch: int, size: int) -> None:
        laws = [e for e in effects if isinstance(e, JointEffect) and not has_hook(e)]
        self._groups = [_group(group, size) for group in _grouped(laws)]
        self.resisting = [e for e in effects if overrides(e, "resist")]
        self.resisted = [np.zeros((batch, len(e.joints))) for e in self.resisting]
        self.remembering = [e for e in effects if e.memory and not has_hook(e)]
        self.remembered: list[Memory | None] = [None for _ in self.remembering]
        self.dry = np.zeros((batch, size))
        self.drive = np.zeros((batch, size))
        self.link = np.zeros((batch, size))

    def __len__(self) -> int:
        return len(self._groups) + len(self.resisting) + len(self.remembering)

    def evaluate(self, motor: JointState, link: JointState, step: float = 0.0) -> None:
        """Set the three sums from the states of motors and links, shape (B, n).

        Effects with memory advance by a step, [s], which may be 0 or unknown (inf).
        """
        for total in (self.dry, self.drive, self.link):
            total.fill(0.0)
        for group in self._groups:
            state = link if group.side == "link" else motor
            group.add(getattr(self, group.side), state)
        for k, effect in enumerate(self.resisting):
            j = list(effect.joints)
            if 0.0 < step < np.inf:
                self.resisted[k] = effect.resist(part(motor, j), self.resisted[k], step)
            self.drive[:, j] += self.resisted[k]
        for k, effect in enumerate(self.remembering):
            joints = [part(motor, [j]) for j in effect.joints]
            memory = self.remembered[k] or effect.begin(joints)
            passed = step if 0.0 < step < np.inf else 0.0
            torque, self.remembered[k] = effect.at_instant(joints, memory, passed)
            self.drive[:, list(effect.joints)] += np.hstack(torque)


def _grouped(laws: Sequence[JointEffect]) -> list[list[JointEffect]]:
    """Groups of effects of one class in which no joint occurs twice."""
    groups: dict[Any, list[JointEffect]] = {}
    before = Counter[Any]()
    for effect in laws:
        kind = type(effect)
        groups.setdefault((kind, before[kind, effect.joints]), []).append(effect)
        before[kind, effect.joints] += 1
    return list(groups.values())


def _group(effects: Sequence[JointEffect], size: int) -> _Group:
    first, joints = effects[0], [e.joints[0] for e in effects]
    gains = np.zeros((len(first.gains), size))
    gains[:, joints] = np.transpose([e.gain_values for e in effects])
    shapes = {s.name: np.full(size, first.values[s.name]) for s in first.shapes}
    for name, values in shapes.items():
        values[joints] = [e.values[name] for e in effects]
    link = first.port is Port.ENVIRONMENT
    return _Group(
        law=first.law,
        side="dry" if first.dry else "link" if link else "drive",
        here=np.isin(np.arange(size), joints),
        gains=tuple(g if g.any() else None for g in gains),
        shapes=shapes,
    )


def direction(v: Array, net_torque: Array) -> Array:
    """Sign of speeds; a joint exactly at rest will move as the net torque does."""
    sign = np.sign(v)
    if sign.all():
        return sign
    return np.where(v == 0.0, np.where(net_torque < 0.0, -1.0, 1.0), sign)


def part(state: JointState, joints: list[int]) -> JointState:
    """State of some of the joints."""
    signals = {k: x[:, joints] for k, x in vars(state).items() if x is not None}
    return JointState(**signals)
