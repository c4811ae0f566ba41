"""Rows of the regression: the columns and the torque of every joint along a motion."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, regressor
from hybrid.effects import Effect
from hybrid.robot.chain import Chain
from hybrid.signals import Motion


@dataclass(frozen=True)
class Rows:
    """Columns of each joint, those of links first, then those of effects, then torque.

    Attributes:
        chain: The arm.
        effects: Effects whose gains are unknown; their shapes are fixed.
        inertial: Link parameters from which the transmitted torque is computed, on
            which some effects depend, shape (n, 10).
        links: Inertial parameters of each joint's columns, as indices out of 10n.
        gains: Indices of effect and gain of each joint's other columns.
    """

    chain: Chain
    effects: tuple[Effect, ...]
    inertial: Array
    links: tuple[tuple[int, ...], ...]
    gains: tuple[tuple[tuple[int, int], ...], ...]

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """First row of each joint, then the number of rows P."""
        pairs = zip(self.links, self.gains, strict=True)
        return (0, *np.cumsum([len(x) + len(y) + 1 for x, y in pairs]).tolist())

    def beside(self, others: Sequence[Effect]) -> Rows:
        """All columns of these and of other effects, also those that are dependent.

        They serve every problem of some of these effects at the same links.
        """
        known = [e for e in others if e in self.effects or not e.changes_signals]
        effects = (*self.effects, *(e for e in known if e not in self.effects))
        gains: list[list[tuple[int, int]]] = [[] for _ in self.links]
        for e, effect in enumerate(effects):
            for joint in effect.reaches(len(gains)):
                gains[joint] += [(e, g) for g in range(len(effect.gains))]
        return replace(self, effects=effects, gains=tuple(map(tuple, gains)))

    def places(self, other: Rows) -> NDArray[np.intp] | None:
        """Where the rows of another are among these; None if these lack one."""
        here = {key: place for place, key in enumerate(self._keys())}
        found = [here.get(key, -1) for key in other._keys()]
        return None if -1 in found else np.array(found)

    def _keys(self) -> Iterator[Hashable]:
        """What each row depends on."""
        effects = [(type(e), e.joints, *e.values.values()) for e in self.effects]
        changed = [k for k, e in enumerate(self.effects) if e.changes_signals]
        common = self.inertial.tobytes(), *(effects[k] for k in changed)
        for joint, links in enumerate(self.links):
            yield from ((common, joint, link) for link in links)
            yield from ((common, joint, effects[e], g) for e, g in self.gains[joint])
            yield common, joint

    def along(self, motion: Motion) -> Array:
        """The rows at full rate along N samples, shape (P, N)."""
        tau, body = motion.tau, RigidBody(self.chain, motion, self.inertial)
        for effect in self.effects:
            if effect.observes:
                motion = effect.observe(motion, body)
                body = RigidBody(self.chain, motion, self.inertial)
        used = sorted({link for links in self.links for link in links})
        Y = regressor(self.chain, motion.q, motion.v, motion.a, used)
        links = Y.transpose(1, 2, 0)
        columns = self._effect_columns(motion, body)
        out = np.empty((self.offsets[-1], len(motion.t)))
        for i, (first, stop) in enumerate(pairwise(self.offsets)):
            own = out[first : stop - 1]
            count, at = len(self.links[i]), np.searchsorted(used, self.links[i])
            # mode="raise" would copy these rows twice.
            np.take(links[i], at, axis=0, out=own[:count], mode="clip")
            for row, (e, g) in enumerate(self.gains[i], count):
                own[row] = columns[i, e][:, g]
            for effect in self.effects:
                if effect.reports and i in effect.joints:
                    own[...] = effect.report(motion.t, own.T).T
            out[stop - 1] = tau[:, i]
        return out

    def _effect_columns(
        self, motion: Motion, body: RigidBody
    ) -> dict[tuple[int, int], Array]:
        """Columns of joint and effect, shape (N, gains) each."""
        found = {}
        for e, effect in enumerate(self.effects):
            values = effect.columns(motion, body)
            for at, joint in enumerate(effect.reaches(len(self.links))):
                found[joint, e] = values[:, at]
        return found
