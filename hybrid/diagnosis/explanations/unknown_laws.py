"""Unknown laws as causes: their columns and priors."""

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.bayes import log_bayes, size_odds
from hybrid.diagnosis.evidence.candidates import Place
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.joint_laws import WAVES, joint_laws, waves
from hybrid.diagnosis.explanations.transmission_laws import transmission_laws
from hybrid.diagnosis.gap.gap import Columns
from hybrid.diagnosis.prior import Prior
from hybrid.effects import effect_classes


class UnknownLaws:
    """Unknown laws of all joints.

    Args:
        evidence: Cross-products of the gap, to which their columns are added.
        rigid: Columns of the background, from whose residual sinusoids are chosen.

    Attributes:
        all: The laws.
    """

    def __init__(self, evidence: Evidence, rigid: Index, prior: Prior) -> None:
        self._evidence, self._prior, self._gap = evidence, prior, evidence.gap
        self._waves: dict[Place, Columns] = {}
        self._wide: dict[tuple[Place, float], Cause] = {}
        left = enumerate(evidence.residuals(rigid))
        self.all = [law for j, x in left if len(x) for law in self._of(j, x)]

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
        for name, x in joint_laws(self._gap, joint):
            yield name, {joint: x}
        yield from transmission_laws(self._gap, joint)

    def _law(self, name: str, joint: int, columns: Columns, cost: float) -> Cause:
        used = {j: x[self._evidence.rows[j]] for j, x in columns.items()}
        sizes = [
            np.sqrt(np.mean(np.sum(x**2, axis=1))) / self._gap.scales[j].torque
            for j, x in used.items()
            if len(x)
        ]
        size = self._prior.unknown_size / (max(sizes) + 1e-12)
        std = np.full(columns[joint].shape[1], size)
        (index,) = self._evidence.add([columns], [std])
        rough = self._prior.real_law_error
        if len(columns) > 1:  # known laws of the transmission have larger errors
            rough = max(x.rough for x in effect_classes().values())
        return Cause((name, (joint,)), index, cost, rough=rough)

    def columns(self, law: Cause) -> Columns:
        """Torque per unit of each gain of a law, by joint, shape (M, d) each."""
        if law.place in self._waves:
            return self._waves[law.place]
        (joint,) = law.place[1]
        laws = self._without_waves(joint)
        return next(columns for name, columns in laws if name == law.place[0])

    def foretold(self, joint: int, left: Array, then: Mask) -> float:
        """Share of squares at some time that a law explains which fits all other times.

        Only laws count that have a good part of the best one's evidence there.

        Args:
            joint: The joint.
            left: Its residual on the evidence's samples, shape (R,), [N·m].
            then: The time, shape (R,).
        """
        evidence, whole = self._evidence, float(left[then] @ left[then])
        found = list[tuple[float, float]]()
        for law in (x for x in self.all if x.place[1] == (joint,)):
            X = evidence.base_columns(law.index, joint)[1].T
            A, noise = X[~then], evidence.noise[joint]
            H, s = A.T @ A / noise, A.T @ left[~then] / noise
            none = np.full(len(s), -np.inf)
            worth, gains = log_bayes(H, s, evidence.precision[law.index], none)
            rest = left[then] - X[then] @ gains
            found.append((float(worth), 1.0 - float(rest @ rest) / whole))
        best = max(worth for worth, _ in found)
        likely = [x for worth, x in found if worth >= self._prior.refined_share * best]
        return max(likely, default=0.0)

    def widened(self, base: Index, law: Cause) -> Cause:
        """A law with the most probable width of its prior; it is made once."""
        columns, std = self.columns(law), self._evidence.precision[law.index] ** -0.5
        none = np.full(len(std), -np.inf)
        factor = self._evidence.trial(base, columns, std, none).prior_factor
        if factor == 1.0:
            return law
        key = law.place, factor
        if key not in self._wide:
            (index,) = self._evidence.add([columns], [factor * std])
            cost = law.cost + float(size_odds(factor))
            self._wide[key] = replace(law, index=index, cost=cost)
        return self._wide[key]

    def open(self, causes: Collection[Cause]) -> list[Cause]:
        """Laws that may be added to some causes: new ones, and few at each joint."""
        there = [c.place for c in causes if c.candidate is None]
        at, most = [joints for _, joints in there], self._prior.most_repeated
        return [
            x for x in self.all if x.place not in there and at.count(x.place[1]) < most
        ]
