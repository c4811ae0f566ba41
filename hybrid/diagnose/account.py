"""What of the gap is explained, joint by joint, and what is left to the unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.background import background
from hybrid.diagnose.bayes import coloured
from hybrid.diagnose.candidates import candidate
from hybrid.diagnose.diagnosis import Unseen
from hybrid.diagnose.evidence import Evidence
from hybrid.diagnose.explanation import Explanation
from hybrid.diagnose.explanations.cause import Cause
from hybrid.diagnose.explanations.search import Search
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.split import between
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.robot.chain import Array

_FREE = 1e3  # times the size of a number: nothing is known of it before
_USUAL = Coulomb, Viscous, TorqueOffset, Armature  # that least squares fits at a joint


_BEYOND = 1.5  # times the squares of noise: what is more on unseen motions is none


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
    ceiling = np.maximum(ceiling - events, 0.0)
    if reached is not None:
        ceiling = np.minimum(ceiling, reached)
    return Account(before, after, ceiling, tuple(depends))


def _coloured(search: Search) -> Array:
    """Squares of the residual that are no noise: too slow for it, (n,).

    Noise of sensors, and of derivatives, is not stronger at low frequencies.
    """
    evidence, gap = search.evidence, search.gap
    found = evidence.solve(search.columns(search.causes))
    squares = np.zeros(len(evidence.rows))
    for i, rows in enumerate(evidence.rows):
        if len(rows):
            back = np.argsort(rows)
            x = evidence.residual(i, found.index, found.gains)[back]
            slow = coloured(x, rows[back], gap.rate, gap.cutoff)
            if slow > search.prior.coloured * float(x @ x):
                squares[i] = slow / search.noise[i]
    return squares


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


def unseen(search: Search, found: Account) -> Unseen:
    """Score an explanation, and what could be had without it.

    Args:
        search: A search that has run.
        found: Its account.
    """
    gap, learn = search.gap, search.learn
    test = ~learn & between(gap, learn)
    evidence, rigid, own = search.rebuilt(test, [*search.causes, *search.whole])
    count = evidence.count.sum(axis=1).astype(float)
    count[count == 0] = np.nan

    def rms(causes: Sequence[Cause]) -> Array:
        index = np.concatenate([rigid, *(own[c] for c in causes)])
        gains = search.evidence.solve(search.columns(causes)).gains
        return _rms(evidence.squares(index, gains).sum(axis=1), count)

    learnt = np.maximum(search.evidence.count.sum(axis=1), 1)
    noise = np.sqrt(found.noise * search.noise / learnt)
    parts = (
        _rms(evidence.power.sum(axis=1), count),
        rms(search.causes),
        _least_squares(gap, learn, test, count),
        rms(search.whole),
        noise,
    )
    return Unseen(*(tuple(map(float, x)) for x in parts))


def _least_squares(
    gap: Gap, learn: NDArray[np.bool_], test: NDArray[np.bool_], count: Array
) -> Array:
    n = gap.robot.size
    blocks, sizes = background(gap)
    blocks, sizes = blocks[:n], sizes[:n]
    for kind in _USUAL:
        for j in range(n):
            c = candidate(gap, kind((j,)))
            blocks.append(gap.columns(c.effect))
            sizes.append(c.std)
    parts = []
    for use in (learn, test):
        evidence = Evidence(gap, use)
        parts.append((evidence, np.concatenate(evidence.add(blocks, sizes))))
    (seen, index), (other, there) = parts
    seen.noise = seen.power.sum(axis=1) / np.maximum(seen.count.sum(axis=1), 1) + 1e-12
    seen.spread(index, _FREE)
    gains = seen.solve(index).gains
    return _rms(other.squares(there, gains).sum(axis=1), count)


def _rms(squares: Array, count: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / count))


def left_unseen(scored: Explanation, found: Account, search: Search) -> float:
    """Part of the gap that is left on unseen motions, where that is not noise.

    What is explained where it was learnt may not be explained elsewhere.
    """
    learnt = np.maximum(search.evidence.count.sum(axis=1), 1)
    variance = np.maximum(found.noise * search.noise / learnt, 1e-300)
    left = whole = 0.0
    for before, after, noise in zip(scored.before, scored.after, variance, strict=True):
        usual = _BEYOND * len(after)
        rest = max(float(after @ after) / noise - usual, 0.0)
        left += rest
        whole += max(float(before @ before) / noise - usual, rest)
    return left / whole if whole > 0 else 0.0
