"""Terms of a search that pass all checks beside each other, and can be placed."""

from __future__ import annotations

from hybrid.diagnose.account import Account, account
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.candidates import Candidate
from hybrid.diagnose.check import check
from hybrid.diagnose.findings import alternatives, elsewhere
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.term import Term
from hybrid.diagnose.thresholds import Thresholds
from hybrid.robot.chain import Array


def vetted(
    gap: Gap, search: Search, limits: Thresholds, reached: Array | None = None
) -> tuple[Account, dict[Term, tuple[str, ...]], Array]:
    """Leave a search the terms that pass all checks beside each other.

    Args:
        gap: The gap.
        search: A search that has run.
        limits: What is worth a cause.
        reached: Squares that more terms left, shape (n,), in units of noise.

    Returns:
        What they explain and miss, what each cannot be told from, and the squares that
        all of them had left, shape (n,), in units of noise.
    """
    found = account(gap, search, limits, reached)
    reached = found.after if reached is None else reached
    kinds: dict[Term, tuple[str, ...]] = {}
    fewer = False
    while True:
        checks = {t: check(search, t, found, limits) for t in search.terms}
        failing = [t for t, x in checks.items() if not x.passes(limits)]
        kinds |= {
            t: alternatives(search, t, limits)
            for t in checks if t not in failing and t not in kinds
        }  # fmt: skip
        if not failing:
            if not (fewer and search.reform()):
                return found, kinds, reached
            fewer, found = False, account(gap, search, limits, reached)
            continue
        fewer = True
        # One after the other: what is left fits anew, and may well pass then.
        out = min(failing, key=search.loss)
        recur = checks[out].recurs
        search.terms = [
            t for t in search.terms
            if t is not out and not (recur and checks[t].recurs)
        ]  # fmt: skip
        search.prune()
        without = account(gap, search, limits, reached)
        if checks[out].echo and checks[out].sound(limits):
            # What noise looks like is not missed.
            reached = reached + without.after - found.after
            without = account(gap, search, limits, reached)
        found = without


def torn(search: Search) -> dict[Term, Candidate]:
    """Terms for which something at another joint does as well, and what does."""
    others = {t: elsewhere(search, t) for t in search.terms}
    return {t: other for t, other in others.items() if other is not None}
