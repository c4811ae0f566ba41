"""How far the gap shrinks on unseen motions, against the structure of the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.evidence.candidates import Candidate, candidate
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.gap.background import background
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects import Effect
from hybrid.recording import Recording

_WORTH = 0.02  # of the gap: less than this cannot be shared out


@dataclass(frozen=True)
class Shrinkage:
    """Gap on unseen motions, RMS over joints in units of their noise.

    Attributes:
        before: With the file's numbers corrected.
        found: And the effects that were found.
        oracle: And the true effects instead, with their true shapes.
        black_box: And boosted trees of position, speed, acceleration and load instead.
        ahead: Log evidence of the true effects over those found, on the recordings
            seen, [nat]: a wrong answer where it is negative, no search could mend.
    """

    before: float
    found: float
    oracle: float
    black_box: float
    ahead: float

    def share(self, after: float) -> float | None:
        """Part of the oracle's shrinkage; nothing where there is none to have."""
        most = self.before - self.oracle
        if most < _WORTH * self.before:
            return None
        return (self.before - after) / most


def shrinkage(
    result: Result, unseen: Sequence[Recording], truth: Sequence[Effect]
) -> Shrinkage:
    """Fit four models alike on the recordings seen, and score them on others.

    Args:
        result: A diagnosis.
        unseen: Recordings of the same plant that it has not seen.
        truth: The effects of the plant.
    """
    gap, search = result.gap, result.search
    test = measure_gap(gap.robot, unseen, cutoff=gap.cutoff)
    found = [term.candidate for term in search.terms]
    true = [candidate(gap, effect) for effect in truth]
    noise, off = search.evidence.noise, search.file_error
    bare, ours, best = (_Fit.of(gap, test, c, noise, off) for c in ([], found, true))
    return Shrinkage(
        before=bare.rms,
        found=ours.rms,
        oracle=best.rms,
        black_box=bare.with_trees(),
        ahead=best.evidence - ours.evidence,
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Effects fitted beside the background on one gap, and what another then has."""

    learnt: Evidence
    scored: Evidence
    index: Index
    gains: Array
    evidence: float

    @classmethod
    def of(
        cls, gap: Gap, test: Gap, chosen: Sequence[Candidate], noise: Array, off: float
    ) -> _Fit:
        learnt, scored = (_evidence(g, chosen, noise, off) for g in (gap, test))
        index = np.arange(learnt.size)
        solution = learnt.solve(index)
        return cls(learnt, scored, index, solution.gains, solution.evidence)

    @property
    def rms(self) -> float:
        return self._rms([self._left(self.scored, j) for j in self._joints])

    def with_trees(self) -> float:
        """RMS once a regression without physics has had what was left."""
        from sklearn.ensemble import HistGradientBoostingRegressor

        left = []
        for j in self._joints:
            now = self._left(self.scored, j)
            if min(len(now), len(self.learnt.rows[j])) > 0:
                trees = HistGradientBoostingRegressor(random_state=0, max_iter=100)
                trees.fit(_features(self.learnt, j), self._left(self.learnt, j))
                now = now - trees.predict(_features(self.scored, j))
            left.append(now)
        return self._rms(left)

    @property
    def _joints(self) -> range:
        return range(len(self.scored.rows))

    def _left(self, evidence: Evidence, joint: int) -> Array:
        return evidence.residual(joint, self.index, self.gains)

    def _rms(self, left: Sequence[Array]) -> float:
        weighted = sum(x @ x / w for x, w in zip(left, self.scored.noise, strict=True))
        return float(np.sqrt(weighted / max(sum(map(len, left)), 1)))


def _features(evidence: Evidence, joint: int) -> Array:
    """Motion of all joints and load of one, shape (R, 3n + 1)."""
    gap, rows = evidence.gap, evidence.rows[joint]
    motion = gap.sampled
    features = (motion.q, motion.v, motion.a, gap.load[:, [joint]])
    return np.column_stack(features)[rows]


def _evidence(
    gap: Gap, chosen: Sequence[Candidate], noise: Array, off: float
) -> Evidence:
    evidence = Evidence(gap)
    rigid = np.concatenate(evidence.add(*background(gap)))
    evidence.scale_prior(rigid, off)
    evidence.noise = noise
    if chosen:
        evidence.add([gap.columns(c.effect) for c in chosen], [c.std for c in chosen])
    return evidence
