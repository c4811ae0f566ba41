"""The linear regression problem of an arm: rigid body and effects in one matrix.

``tau_i = Σ_k columns_ik · theta_k`` for every joint i. The unknowns theta are the base
inertial parameters, then the gains of the effects that can be identified.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.dynamics import (
    BaseParameters,
    RigidBody,
    effect_gains,
    regressor_law,
    rich_motion,
    stacked_base,
    stacked_columns,
)
from hybrid.effects import Effect
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

_WEIGHTLESS = 1e-9


@dataclass(frozen=True)
class Problem:
    """The unknowns of an arm with some effects, and the columns that they multiply.

    Attributes:
        chain: The arm.
        effects: Effects whose gains are unknown; their shapes are fixed.
        base: Base parameters of all inertial parameters and gains.
        inertial: Link parameters from which the transmitted torque is computed, on
            which some effects depend, shape (n, 10).
        columns: Index of the effect and of its gain, for each column after the 10n
            inertial ones.
    """

    chain: Chain
    effects: tuple[Effect, ...]
    base: BaseParameters
    inertial: Array
    columns: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        """Number of unknowns p."""
        return self.base.size

    @property
    def rigid(self) -> Index:
        """Indices of the base inertial parameters among the unknowns."""
        return np.arange(self.size - len(self.gains))

    @cached_property
    def gains(self) -> tuple[tuple[int, int, int], ...]:
        """Indices (unknown, effect, gain) of every gain among the unknowns."""
        rigid = 10 * self.chain.size
        return tuple(
            (unknown, *self.columns[column - rigid])
            for unknown, column in enumerate(self.base.kept)
            if column >= rigid
        )

    @cached_property
    def lower(self) -> Array:
        """Smallest physical value of each unknown, shape (p,); −inf without one."""
        lower = np.full(self.size, -np.inf)
        for unknown, e, g in self.gains:
            if self.effects[e].gains[g].lower >= 0:
                lower[unknown] = 0.0 - self._expansion_point(e, g)
        return lower

    def _expansion_point(self, e: int, g: int) -> float:
        """Value of a gain from which its unknown is the change; 0 for most effects."""
        effect = self.effects[e]
        return effect.values[effect.gains[g].name] if effect.changes_signals else 0.0

    @cached_property
    def support(self) -> tuple[Index, ...]:
        """Indices of the unknowns that change the torque of joint i, for each joint."""
        motion = rich_motion(self.chain)
        stacked = stacked_columns(self.chain, self.effects, self.columns, motion)
        size = np.abs(stacked[:, :, list(self.base.kept)]).max(axis=0)
        return tuple(np.flatnonzero(row > _WEIGHTLESS * row.max()) for row in size)

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """First row of each joint in :meth:`rows`, then the number of rows P."""
        return (0, *np.cumsum([len(x) + 1 for x in self.support]).tolist())

    @cached_property
    def torque_rows(self) -> Index:
        """Which :meth:`rows` are torque, shape (n,)."""
        return np.array(self.offsets[1:]) - 1

    @cached_property
    def link_entries(self) -> tuple[int, ...]:
        """Rows that are columns of links, as entries of the flattened regressor."""
        kept, size = np.array(self.base.kept)[self.rigid], 10 * self.chain.size
        each = [x[x < len(kept)] for x in self.support]
        return tuple(size * i + int(k) for i, x in enumerate(each) for k in kept[x])

    def rows(self, motion: Motion) -> Array:
        """Columns of each joint by its :attr:`support`, then its torque, (P, N)."""
        tau, body = motion.tau, RigidBody(self.chain, motion, self.inertial)
        for effect in self.effects:
            if effect.observes:
                motion = effect.observe(motion, body)
                body = RigidBody(self.chain, motion, self.inertial)
        columns = [effect.columns(motion, body) for effect in self.effects]
        reached = [list(effect.reaches(self.chain.size)) for effect in self.effects]
        out = np.empty((self.offsets[-1], len(motion.t)))
        law = regressor_law(self.chain, self.link_entries)
        links = law.rows((motion.q, motion.v, motion.a))
        for i, (first, stop) in enumerate(pairwise(self.offsets)):
            own = out[first : stop - 1]
            gains = [x for x in self.gains if x[0] in self.support[i]]
            count = len(own) - len(gains)
            own[:count], links = links[:count], links[count:]
            for row, (_, e, g) in zip(own[count:], gains, strict=True):
                row[:] = columns[e][:, reached[e].index(i), g]
            for effect in self.effects:
                if effect.reports and i in effect.joints:
                    own[...] = effect.report(motion.t, own.T).T
            out[stop - 1] = tau[:, i]
        return out

    def complete(self) -> Problem:
        """The same problem with all gains of its effects; those added come last."""
        added = set(effect_gains(self.effects)) - set(self.columns)
        if not added:
            return self
        columns = (*self.columns, *sorted(added))
        base = stacked_base(self.chain, self.effects, columns)
        return replace(self, base=base, columns=columns)

    def fitted(self, theta: Array) -> tuple[BaseParameters, tuple[Effect, ...]]:
        """Base parameters and effects with the values of a solution, shape (p,)."""
        effects = list(self.effects)
        for unknown, e, g in self.gains:
            value = self._expansion_point(e, g) + theta[unknown]
            effects[e] = effects[e].at({effects[e].gains[g].name: value})
        return self.base.with_values(theta), tuple(effects)

    def rigid_inertial(self, theta: Array) -> Array:
        """Link parameters that give the rigid torque of a solution, shape (n, 10)."""
        n = 10 * self.chain.size
        return self.base.with_values(theta).standard()[:n].reshape(-1, 10)


def part(motion: Motion, samples: slice) -> Motion:
    """A slice of a motion in time."""
    arrays = {k: x for k, x in vars(motion).items() if isinstance(x, np.ndarray)}
    signals: dict[str, Any] = {k: x[samples] for k, x in arrays.items()}
    return replace(motion, **signals)


def build_problem(
    chain: Chain,
    effects: Sequence[Effect],
    *,
    inertial: Array | None = None,
    without: Collection[tuple[int, str]] = (),
) -> Problem:
    """Stack rigid body and effects and reduce them to identifiable unknowns.

    The transmitted torque is that of the link parameters of the chain, or of others,
    shape (n, 10). Gains in ``without`` (index of the effect, name) are no unknowns.
    """
    columns = effect_gains(effects, without)
    base = stacked_base(chain, effects, columns)
    own = chain.inertial if inertial is None else inertial
    return Problem(chain, tuple(effects), base, own, columns)
