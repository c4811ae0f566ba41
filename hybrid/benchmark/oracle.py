"""How far the gap shrinks on unseen motions, against the structure of the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import Candidate, candidate
from hybrid.diagnose.diagnose import Result
from hybrid.diagnose.evidence import Evidence
from hybrid.diagnose.gap import Gap, measure_gap
from hybrid.effects import Effect
from hybrid.recording import Recording
from hybrid.robot.chain import Array

_WORTH = 0.02  # of the gap: less than this cannot be shared out


@dataclass(frozen=True)
class Shrinkage:
    """Gap on unseen motions, RMS over joints in units of their noise.

    Attributes:
        before: With the file's numbers corrected.
        found: And the effects that were found.
        oracle: And the true effects instead, with their true shapes.
    """

    before: float
    found: float
    oracle: float

    @property
    def share(self) -> float | None:
        """Part of the oracle's shrinkage; nothing where there is none to have."""
        most = self.before - self.oracle
        if most < _WORTH * self.before:
            return None
        return (self.before - self.found) / most


def shrinkage(
    result: Result, unseen: Sequence[Recording], truth: Sequence[Effect]
) -> Shrinkage:
    """Fit three structures alike on the recordings seen, and score them on others.

    Args:
        result: A diagnosis.
        unseen: Recordings of the same plant that it has not seen.
        truth: The effects of the plant.
    """
    gap, search = result.gap, result.search
    test = measure_gap(gap.robot, unseen, cutoff=gap.cutoff)
    found = [term.candidate for term in search.terms]
    true = [candidate(gap, effect) for effect in truth]
    noise, off = search.evidence.noise, search.off
    rms = [_rms(gap, test, set_, noise, off) for set_ in ([], found, true)]
    return Shrinkage(*rms)


def _rms(
    gap: Gap, test: Gap, chosen: Sequence[Candidate], noise: Array, off: float
) -> float:
    learnt, scored = (_evidence(g, chosen, noise, off) for g in (gap, test))
    index = np.arange(learnt.size)
    squares = scored.squares(index, learnt.solve(index).gains)
    return float(np.sqrt((squares.sum(axis=1) / noise).sum() / scored.count.sum()))


def _evidence(
    gap: Gap, chosen: Sequence[Candidate], noise: Array, off: float
) -> Evidence:
    evidence = Evidence(gap)
    rigid = np.concatenate(evidence.add(*background(gap)))
    evidence.spread(rigid, off)
    evidence.noise = noise
    if chosen:
        evidence.add([gap.columns(c.effect) for c in chosen], [c.std for c in chosen])
    return evidence
