"""The explained and the unexplained part of the gap, by joint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.noise import low_frequency_excess
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.search import Search


@dataclass(frozen=True)
class Account:
    """Residual squares on the training samples, by joint, in units of noise.

    Attributes:
        before: With the background alone, shape (n,).
        after: With all known causes, shape (n,).
        ceiling: With the unknown laws as well, shape (n,), and without the excess at
            low frequencies that no law explains.
        noise: The same as a variance, shape (n,), [N²·m²].
        depends: Signals on which the unknown laws of each joint depend.
    """

    before: Array
    after: Array
    ceiling: Array
    noise: Array
    depends: tuple[str, ...]

    @property
    def explained(self) -> Array:
        """Squares that the known causes explain, shape (n,)."""
        return np.maximum(self.before - self.after, 0.0)

    @property
    def missed(self) -> Array:
        """Squares that have no known cause, shape (n,)."""
        return np.maximum(self.after - self.ceiling, 0.0)

    @property
    def unknown(self) -> float:
        """Share of the explainable squares that has no known cause, 0 to 1."""
        whole = self.explained.sum() + self.missed.sum()
        return float(self.missed.sum() / whole) if whole > 0 else 0.0


def account(search: Search, reached: Array | None = None) -> Account:
    """Account for the gap on the training samples of a search that has run.

    ``reached`` is the ceiling of an explanation with more causes, shape (n,).
    """
    laws = [c for c in search.causes if c.candidate is None]
    evidence = search.evidence
    found = evidence.solve(search.columns(search.causes))

    def left(causes: Sequence[Cause]) -> Array:
        """Residual squares where all other causes have no torque, (n,)."""
        index = search.columns(causes)
        return evidence.squares(index, found.of(index)) / search.noise.measured

    depends = [
        " and ".join(c.place[0] for c in laws if c.place[1] == (j,))
        for j in range(search.gap.robot.size)
    ]
    before, after, ceiling = map(left, ([], search.known, search.causes))
    slow = _slow_share(search)
    for i in np.flatnonzero(slow):
        depends[i] = depends[i] or "what does not recur"
    ceiling = ceiling * np.maximum(1.0 - slow, 0.0)
    if reached is not None:
        ceiling = np.minimum(ceiling, reached)
    variance = ceiling * search.noise.measured / np.maximum(evidence.count, 1)
    return Account(before, after, ceiling, variance, tuple(depends))


def _slow_share(search: Search) -> Array:
    """Share of the residual's squares that is too slow for noise, shape (n,)."""
    evidence, gap = search.evidence, search.gap
    residuals = evidence.residuals(search.columns(search.causes))
    parts = np.zeros(len(residuals))
    for i, (x, rows) in enumerate(zip(residuals, evidence.rows, strict=True)):
        if len(rows):
            slow = low_frequency_excess(x, rows, gap.rate, gap.cutoff)
            parts[i] = slow / max(float(x @ x), 1e-300)
    return np.where(parts > search.prior.slow_share, parts, 0.0)
