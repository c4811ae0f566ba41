"""What of the gap is explained, what is missed, and what it depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.diagnose.attribute import Search
from hybrid.diagnose.bayes import coloured, memory, quiet
from hybrid.diagnose.ceiling import recoverable
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.thresholds import Thresholds
from hybrid.robot.chain import Array

_CALM = 0.25  # of the cut-off: the band in which events are looked for


@dataclass(frozen=True)
class Account:
    """Squares of the gap on the samples learnt from, by joint, in units of noise.

    Attributes:
        before: With the background alone, shape (n,).
        after: With all terms, shape (n,).
        recovered: What a flexible regression still recovers, beyond chance, shape (n,).
        doubtful: What it recovers besides, on most folds but not on all, shape (n,).
        missed: What is there and has no cause, if it matters, shape (n,).
        refused: What terms explain that do not hold, shape (n,).
        depends: What the missed part depends on first, for each joint.
        noise: Sum of squares of noise alone, shape (n,).
    """

    before: Array
    after: Array
    recovered: Array
    doubtful: Array
    missed: Array
    refused: Array
    depends: tuple[str, ...]
    noise: Array

    @property
    def explained(self) -> Array:
        """What the terms explain, shape (n,)."""
        return np.maximum(self.before - self.after, 0.0)


def account(
    gap: Gap, search: Search, limits: Thresholds, reached: Array | None = None
) -> Account:
    """What is explained and what is missed, joint by joint.

    Args:
        gap: The gap.
        search: A search that has run.
        limits: What is worth a cause.
        reached: Squares left by more terms, some of which do not hold, shape (n,), in
            units of noise.
    """
    evidence = search.evidence
    alone = evidence.solve(search.background)
    whole = evidence.solve(search.base())
    weight = evidence.noise
    before = evidence.squares(alone.index, alone.gains).sum(axis=1) / weight
    after = evidence.squares(whole.index, whole.gains).sum(axis=1) / weight
    refused = np.zeros_like(after) if reached is None else after - reached
    refused = np.where(refused > limits.evident, refused, 0.0)
    (recovered, doubtful, missed), depends = np.zeros((3, len(weight))), []
    for i, rows in enumerate(evidence.rows):
        if not len(rows):
            depends.append("")
            continue
        left = evidence.residual(i, whole.index, whole.gains)
        # Time order: what lags needs its past.
        order = np.argsort(rows)
        rows = rows[order]
        squares, more, of, rest = recoverable(gap, i, left[order], rows, weight[i])
        # Noise as estimated before may hold what no effect explains.
        calm = quiet(rest, rows, gap.rate, _CALM * gap.cutoff)
        usual = float(np.mean(rest[calm] ** 2))
        noise = usual * memory(rest[calm], rows[calm])
        events = float(np.sum(rest[~calm] ** 2 - usual))
        evident = limits.evident * noise
        recovered[i] = max(0.0, squares - evident) / weight[i]
        doubtful[i] = max(0.0, squares + more - evident) / weight[i] - recovered[i]
        squares = max(0.0, squares - limits.spurious * float(left @ left))
        colour = coloured(rest[calm], rows[calm], gap.rate, gap.cutoff)
        if colour > limits.coloured * float(rest @ rest):
            squares, of = squares + colour, of or "what does not recur"
        tau = gap.measured[rows, i]
        small = limits.negligible**2 * float(tau @ tau)
        least = max(evident, small)
        parts = [
            (x, name) for x, name in ((squares, of), (events, "events")) if x > least
        ]
        missed[i] = sum(x for x, _ in parts) / weight[i]
        depends.append(max(parts)[1] if parts else "")
        if refused[i] > max(missed[i], small / weight[i]):
            missed[i], depends[i] = refused[i], depends[i] or "what no known law fits"
    return Account(
        before,
        after,
        recovered,
        doubtful,
        missed,
        refused,
        tuple(depends),
        after - missed,
    )
