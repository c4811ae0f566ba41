"""What of the gap is explained, joint by joint, and what is left to the unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import coloured
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.search import Search


@dataclass(frozen=True)
class Account:
    """Squares of the gap on the samples learnt from, by joint, in units of noise.

    Attributes:
        before: With the background alone, shape (n,).
        after: With all known causes, shape (n,).
        ceiling: With the unknown laws as well, shape (n,), and without what is no noise
            although no law has it.
        depends: What the unknown part depends on, for each joint.
    """

    before: Array
    after: Array
    ceiling: Array
    depends: tuple[str, ...]

    @property
    def explained(self) -> Array:
        """What the known causes explain, shape (n,)."""
        return np.maximum(self.before - self.after, 0.0)

    @property
    def missed(self) -> Array:
        """What has no known cause, shape (n,)."""
        return np.maximum(self.after - self.ceiling, 0.0)

    @property
    def noise(self) -> Array:
        """Sum of squares of noise alone, shape (n,)."""
        return self.ceiling

    @property
    def unknown(self) -> float:
        """Part of the explainable gap that no known cause explains."""
        whole = self.explained.sum() + self.missed.sum()
        return float(self.missed.sum() / whole) if whole > 0 else 0.0


def account(search: Search, reached: Array | None = None) -> Account:
    """What an explanation explains where it was learnt.

    Args:
        search: A search that has run.
        reached: Squares that more causes left, some of which are not believed, shape
            (n,).
    """
    laws = [c for c in search.causes if c.candidate is None]
    left = [_left(search, causes) for causes in ([], search.known, search.causes)]
    depends = [
        " and ".join(c.place[0] for c in laws if c.place[1] == (j,))
        for j in range(search.gap.robot.size)
    ]
    before, after, ceiling = left
    events = _coloured(search)
    for i in np.flatnonzero(events):
        depends[i] = depends[i] or "what does not recur"
    ceiling = ceiling * (1.0 - events)
    if reached is not None:
        ceiling = np.minimum(ceiling, reached)
    return Account(before, after, ceiling, tuple(depends))


def _coloured(search: Search) -> Array:
    """Part of the residual's squares that is no noise: too slow for it, (n,).

    Noise of sensors, and of derivatives, is not stronger at low frequencies.
    """
    evidence, gap = search.evidence, search.gap
    found = evidence.solve(search.columns(search.causes))
    parts = np.zeros(len(evidence.rows))
    for i, rows in enumerate(evidence.rows):
        if len(rows):
            back = np.argsort(rows)
            x = evidence.residual(i, found.index, found.gains)[back]
            slow = coloured(x, rows[back], gap.rate, gap.cutoff)
            part = slow / max(float(x @ x), 1e-300)
            if part > search.prior.coloured:
                parts[i] = part
    return parts


def _left(search: Search, causes: Sequence[Cause]) -> Array:
    """Squares that some causes leave, those of the others put to nothing, (n,).

    The file's numbers are those of the whole explanation; without any cause they are
    fitted anew.
    """
    evidence = search.evidence
    found = evidence.solve(search.columns(search.causes if causes else []))
    index = search.columns(causes)
    left = evidence.squares(index, found.of(index)).sum(axis=1)
    return np.asarray(left / search.noise)
