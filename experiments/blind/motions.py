"""How far the error of the simulated motion shrinks, against the truth's structure."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from hybrid.diagnosis.answer.replay import Replay
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.evidence.candidates import Candidate, candidate
from hybrid.diagnosis.explanations.explanation import explain
from hybrid.diagnosis.explanations.search import Search
from hybrid.effects import Effect
from hybrid.errors import EffectError

_HORIZON = 0.5  # s
_WORTH = 0.1  # of the error: less than this cannot be shared out


@dataclass(frozen=True)
class MotionError:
    """Error of half a second's simulation, median over windows of the RMS, [rad].

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


def having(search: Search, chosen: Sequence[Candidate]) -> Search:
    """The same search with some effects as all of its causes."""
    other = copy(search)
    other.causes = [search.cause(c) for c in chosen]
    return other


def motion_error(result: Result, truth: Sequence[Effect]) -> MotionError | None:
    """Simulate the motions kept for scoring with three models fitted alike.

    Args:
        result: A diagnosis.
        truth: The effects of the plant.

    Returns:
        The errors of the joints of the true effects; nothing if what was kept for
        scoring is too short, or an effect cannot be simulated.
    """
    gap, search = result.gap, result.search
    joints = sorted({j for effect in truth for j in effect.joints})
    true = [candidate(gap, effect) for effect in truth]
    found = [term.candidate for term in search.terms]

    def error(chosen: Sequence[Candidate]) -> float:
        replay = Replay(explain(having(search, chosen)))
        if replay.horizon != _HORIZON:
            return np.nan
        squares = replay.squares_of(replay.effects)[:, joints]
        return float(np.median(np.sqrt(squares.mean(axis=1))))

    try:
        errors = [error(chosen) for chosen in ([], found, true)]
    except EffectError:
        return None
    return MotionError(*errors) if np.all(np.isfinite(errors)) else None
