"""Unknown laws as causes: what each is of, its columns, and its prior."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Place
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.twist import twists
from hybrid.diagnosis.explanations.unknown import WAVES, unknown_laws, waves
from hybrid.diagnosis.gap.gap import Columns
from hybrid.diagnosis.prior import Prior
from hybrid.effects import effect_classes


class Laws:
    """Unknown laws of all joints, whose columns are in the evidence.

    Args:
        evidence: Cross-products of the gap.
        rigid: Columns of the background, of whose residual waves are picked.
        prior: What is believed before any recording.

    Attributes:
        all: The laws.
    """

    def __init__(self, evidence: Evidence, rigid: Index, prior: Prior) -> None:
        self._evidence, self._prior, self._gap = evidence, prior, evidence.gap
        self._waves: dict[Place, Columns] = {}
        found = evidence.solve(rigid)
        left = [
            evidence.residual(j, found.index, found.gains)
            for j in range(len(evidence.rows))
        ]
        self.all = [law for j, x in enumerate(left) if len(x) for law in self._of(j, x)]

    def _of(self, joint: int, left: Array) -> Iterator[Cause]:
        for name, columns in self._without_waves(joint):
            yield self._law(name, joint, columns, self._prior.unknown)
        rows = self._evidence.rows[joint]
        picked = self._prior.unknown + float(WAVES * np.log(len(rows)))
        for name, x in waves(self._gap, joint, left, rows):
            if x.shape[1]:
                self._waves[name, (joint,)] = {joint: x}
                yield self._law(name, joint, {joint: x}, picked)

    def _without_waves(self, joint: int) -> Iterator[tuple[str, Columns]]:
        for name, x in unknown_laws(self._gap, joint):
            yield name, {joint: x}
        yield from twists(self._gap, joint)

    def _law(self, name: str, joint: int, columns: Columns, cost: float) -> Cause:
        seen = {j: x[self._evidence.rows[j]] for j, x in columns.items()}
        sizes = [
            np.sqrt(np.mean(np.sum(x**2, axis=1))) / self._gap.scales[j].torque
            for j, x in seen.items()
            if len(x)
        ]
        std = np.full(columns[joint].shape[1], self._prior.size / (max(sizes) + 1e-12))
        (index,) = self._evidence.add([columns], [std])
        rough = self._prior.misfit
        if len(columns) > 1:  # known laws of where a link lies leave out more
            rough = max(x.rough for x in effect_classes().values())
        return Cause((name, (joint,)), index, cost, rough=rough)

    def columns(self, law: Cause) -> Columns:
        """Torque per unit of each gain of a law at every sample, by joint."""
        if law.place in self._waves:
            return self._waves[law.place]
        (joint,) = law.place[1]
        return dict(self._without_waves(joint))[law.place[0]]

    def widened(self, base: Index, law: Cause) -> Cause:
        """A law under as wide a prior as is most probable.

        Args:
            base: Columns that are in already.
            law: One of the laws.
        """
        columns, std = self.columns(law), self._evidence.precision[law.index] ** -0.5
        none = np.full(len(std), -np.inf)
        wider = self._evidence.trial(base, columns, std, none).wider
        if wider == 1.0:
            return law
        (index,) = self._evidence.add([columns], [wider * std])
        return replace(law, index=index, cost=law.cost + float(np.log(wider)))

    def open(self, causes: Collection[Cause]) -> list[Cause]:
        """Laws that are not among some causes, at joints where there are few yet."""
        there = [c.place for c in causes if c.candidate is None]
        at = [joints for _, joints in there]
        most = self._prior.repeated
        return [
            x for x in self.all if x.place not in there and at.count(x.place[1]) < most
        ]
