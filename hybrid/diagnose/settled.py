"""Findings that are all of use on motions that no step has seen, beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.account import Account
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.diagnosis import Finding
from hybrid.diagnose.explanation import Explanation, explain, shares
from hybrid.diagnose.findings import findings
from hybrid.diagnose.refit import refit
from hybrid.diagnose.term import Term
from hybrid.diagnose.thresholds import thresholds
from hybrid.diagnose.unseen import negligible, useful_terms
from hybrid.diagnose.vetted import vetted
from hybrid.effects import Effect
from hybrid.robot.chain import Array

_TINY = 0.01  # of all that is explained


@dataclass(frozen=True, eq=False)
class Settled:
    """What is named, and what it explains.

    Attributes:
        found: The account of the gap where the terms were learnt.
        scored: The terms on motions that no step has seen.
        effects: The same as effects with fitted values.
        causes: Findings, largest share first.
        odd: Whether something that is not small was found, and is of no use there.
    """

    found: Account
    scored: Explanation
    effects: tuple[Effect, ...]
    causes: tuple[Finding, ...]
    odd: bool


def settled(
    search: Search,
    learn: NDArray[np.bool_],
    found: Account,
    kinds: Mapping[Term, tuple[str, ...]],
    reached: Array,
    rng: np.random.Generator,
) -> Settled:
    """Leave a search the terms that are of use, and vet what stays, until all are.

    Args:
        search: A search whose terms are vetted.
        learn: Samples that it learnt from, shape (M,).
        found: The account of the gap there.
        kinds: What each term cannot be told from.
        reached: Squares that more terms left, shape (n,), in units of noise.
        rng: Draws of the bootstrap.
    """
    gap, limits, odd = search.gap, thresholds(), False
    while True:
        scored = explain(gap, search, learn)
        effects = refit(gap, search)
        own = [kinds[t] for t in search.terms]
        causes = findings(scored, effects, own, shares(search, rng), rng)
        idle = _idle(scored, causes)
        useful = [t for t in useful_terms(scored, found, rng) if t not in idle]
        if len(useful) == len(search.terms):
            return Settled(found, scored, effects, causes, odd)
        odd |= not negligible(scored, useful)
        search.terms = useful
        found, more, _ = vetted(gap, search, limits, reached)
        kinds = {**kinds, **more}


def unsure(finding: Finding) -> bool:
    """Whether a finding may do harm on motions that no step has seen."""
    return finding.shrink["torque"].interval[0] < 0


def _idle(scored: Explanation, causes: Sequence[Finding]) -> list[Term]:
    """Terms of what is tiny beside others, and not surely of use."""
    return [
        scored.terms[k]
        for f in causes if f.share < _TINY and unsure(f)
        for k in scored.members(f.effect)
    ]  # fmt: skip
