"""How far a gap shrinks in motion: the simulator replayed from measured states.

Both sides of a comparison have the corrected background: links and declared friction
as they were fitted together with all effects. The replay starts in many measured states
of motions that no step has seen, and is driven by the measured torque; open loop, it
departs from the measured motion by what the simulator lacks. Unstable postures let any
model depart sooner or later, so that windows are short, the same on both sides, and
compared by their medians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.diagnosis import Shrink
from hybrid.diagnose.explanation import Explanation, between, split
from hybrid.diagnose.simulator import corrected, scored_effects
from hybrid.effects import Effect
from hybrid.plant.rollout import Windows, rollout
from hybrid.robot.chain import Array
from hybrid.signals import Motion

HORIZONS = (0.1, 0.5, 2.0)  # s
_USUAL = 0.5  # s; also the least time between the starts of two windows
_MOST_WINDOWS = 24
_FEWEST_WINDOWS = 3
_STEP = 0.001  # s
_RESAMPLES = 400
_BYPRODUCT = 0.05  # of the largest fall in torque; joints below are merely touched
_LOST = np.pi  # rad; a replay that is so far off is lost, however far
_STEP_MATTERS = 0.1  # of the motion error before


class Replay:
    """Windows of the motions kept for scoring, and the simulator run along them.

    Args:
        scored: What was found.
        most: Most windows; they start half a second apart or more.
        step: Longest physics step, [s].

    Attributes:
        scored: What was found.
        effects: Its terms, with the gains that they were scored with.
        motions: The motions kept for scoring at decimated samples, with their
            measured torque, filtered.
        windows: W windows along them, as long as the longest horizon.
        fits: Where a window's samples up to each horizon are all usable, shape (H, W).
    """

    def __init__(
        self, scored: Explanation, *, most: int = _MOST_WINDOWS, step: float = _STEP
    ) -> None:
        self.scored = scored
        self.effects = scored_effects(scored)
        self.motions, usable = _motions(scored)
        self._step = step
        self._spans = [max(1, round(h * self.motions[0].rate)) for h in HORIZONS]
        self.windows, self.fits = _windows(usable, self._spans, most)
        self._known: dict[tuple[frozenset[int], float], Array] = {}

    def squares(self, terms: Iterable[int], *, step: float | None = None) -> Array:
        """Mean squares of the motion error with some terms.

        Args:
            terms: Indices of the terms that the simulator has.
            step: Longest physics step, [s].

        Returns:
            For each horizon, window and joint, shape (H, W, n), [rad²].
        """
        key = frozenset(terms), step or self._step
        if key not in self._known:
            effects = [self.effects[k] for k in sorted(key[0])]
            self._known[key] = self.squares_of(effects, step=key[1])
        return self._known[key]

    def squares_of(self, effects: Sequence[Effect], *, step: float = _STEP) -> Array:
        """The same with any effects: candidates that torque alone cannot settle."""
        robot, others = corrected(self.scored, effects)
        shown = rollout(robot, others, self.motions, self.windows, step=step)
        off = shown - self.windows.of([m.q for m in self.motions])
        off = np.where(np.isnan(off), _LOST, np.clip(off, -_LOST, _LOST))
        total = np.cumsum(off[1:] ** 2, axis=0)
        return np.stack([total[s - 1] / s for s in self._spans])

    @property
    def all_terms(self) -> frozenset[int]:
        """Indices of all terms."""
        return frozenset(range(len(self.effects)))

    def has(self, horizon: float) -> bool:
        """Whether enough windows are as long as a horizon."""
        return int(self.fits[HORIZONS.index(horizon)].sum()) >= _FEWEST_WINDOWS

    def error(self, squares: Array, joints: Sequence[int], horizon: float) -> Array:
        """RMS over joints and time in each window that fits, shape (W',), [rad]."""
        h = HORIZONS.index(horizon)
        return np.sqrt(squares[h][self.fits[h]][:, list(joints)].mean(axis=1))

    def blocks(self, horizon: float) -> NDArray[np.intp]:
        """Block of each window that fits; windows that overlap share one, shape (W',)."""
        h, w = HORIZONS.index(horizon), self.windows
        block = np.stack([w.motion, w.sample // self._spans[h]], axis=1)[self.fits[h]]
        return np.unique(block, axis=0, return_inverse=True)[1].ravel()


def motion_shrink(
    replay: Replay,
    members: Sequence[int],
    rng: np.random.Generator,
    *,
    horizon: float = _USUAL,
) -> Shrink | None:
    """Motion error with everything but some terms, and with them, where they act.

    Args:
        replay: Windows of the motions kept for scoring.
        members: Indices of the terms; all of them for what they do together.
        rng: Draws of the bootstrap.
        horizon: One of ``HORIZONS``, [s].

    Returns:
        Median over windows of the RMS over joints and time, [rad], before and after;
        nothing if too few windows are that long.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    if not replay.has(horizon):
        return None
    joints = _main_joints(replay, members)
    before, after = (
        replay.error(replay.squares(terms), joints, horizon)
        for terms in (replay.all_terms - set(members), replay.all_terms)
    )
    draws = [
        _removed(before[pick], after[pick])
        for pick in _resampled(replay.blocks(horizon), rng)
    ]
    low, high = np.quantile(draws, [0.025, 0.975])
    return Shrink(
        float(np.median(before)),
        float(np.median(after)),
        _removed(before, after),
        (float(low), float(high)),
        horizon,
    )


def rollout_agrees(
    replay: Replay,
    term: int,
    rng: np.random.Generator,
    *,
    instead: Sequence[Effect] | None = None,
) -> bool | None:
    """Whether a term lowers the motion error, as it does lower the torque's.

    Args:
        replay: Windows of the motions kept for scoring.
        term: Index of the term.
        rng: Draws of the bootstrap.
        instead: What to compare the term with; by default the simulator without it.
            With rivals, ``True`` means that the term replays better than they do.

    Returns:
        True or False where 95 % of the resampled windows say so at the longest horizon
        that is not longer than half a second; nothing where they do not.
    """
    horizon = next((h for h in (_USUAL, HORIZONS[0]) if replay.has(h)), None)
    if horizon is None:
        return None
    rest = replay.all_terms - {term}
    without = replay.squares(rest)
    if instead is not None:
        others = [replay.effects[k] for k in sorted(rest)]
        without = replay.squares_of([*others, *instead])
    joints = _main_joints(replay, [term])
    before = replay.error(without, joints, horizon)
    after = replay.error(replay.squares(replay.all_terms), joints, horizon)
    fall = np.log(np.maximum(before, 1e-12) / np.maximum(after, 1e-12))
    draws = [np.mean(fall[p]) for p in _resampled(replay.blocks(horizon), rng)]
    low, high = np.quantile(draws, [0.025, 0.975])
    return True if low > 0 else False if high < 0 else None


def step_warning(replay: Replay) -> str | None:
    """A warning if the replay at half the step says something else."""
    if not replay.has(_USUAL):
        return None
    joints, changes = range(replay.scored.gap.robot.size), []
    before = np.median(replay.error(replay.squares(()), joints, _USUAL))
    for terms in {frozenset[int](), replay.all_terms}:
        whole, half = (
            np.median(replay.error(replay.squares(terms, step=s), joints, _USUAL))
            for s in (_STEP, _STEP / 2)
        )
        changes.append(abs(half - whole))
    if max(changes) <= _STEP_MATTERS * before:
        return None
    return (
        f"replayed at half the step of {1e3 * _STEP:g} ms, the motion error differs by "
        f"{max(changes) / before:.0%}; take its shrinkage as a rough figure"
    )


def _motions(
    scored: Explanation,
) -> tuple[tuple[Motion, ...], list[NDArray[np.bool_]]]:
    """Decimated motions that hold samples kept for scoring, and which these are."""
    gap = scored.gap
    learn = split(gap)
    unseen = ~learn & between(gap, learn)
    motions, usable = [], []
    for r, (m, _, sampler) in enumerate(gap):
        own, keep = gap.trajectory == r, slice(None, None, sampler.factor)
        fresh = unseen[own] & m.mask[keep]
        alike = not motions or np.isclose(motions[0].rate, m.rate / sampler.factor, 1e-4)
        if fresh.any() and alike:
            tau = sampler(m.tau) + gap.left[own]
            warm = None if m.temperature is None else m.temperature[keep]
            parts = (x[keep] for x in (m.t, m.q, m.v, m.a))
            motions.append(Motion(*parts, tau, m.mask[keep], warm, m.joints, m.source))
            usable.append(fresh)
    return tuple(motions), usable


def _windows(
    usable: Sequence[NDArray[np.bool_]], spans: Sequence[int], most: int
) -> tuple[Windows, NDArray[np.bool_]]:
    """Windows at least half a second apart that fit the shorter horizons."""
    found, fits = [], []
    usual = spans[HORIZONS.index(_USUAL)]
    for r, fresh in enumerate(usable):
        # How many usable samples in a row follow each one.
        gaps = np.append(np.flatnonzero(~fresh), len(fresh))
        run = gaps[np.searchsorted(gaps, np.arange(len(fresh)))] - np.arange(len(fresh))
        k = 0
        while k < len(fresh):
            if run[k] > usual:
                found.append((r, k))
                fits.append(run[k] > np.array(spans))
                k += usual
            else:
                k += max(int(run[k]), 1)
    pick = np.arange(len(found))
    if len(found) > most:
        pick = np.linspace(0, len(found) - 1, most).round().astype(int)
    chosen = np.array(found, dtype=np.intp).reshape(-1, 2)[pick]
    allowed = np.array(fits, dtype=bool).reshape(-1, len(spans))[pick].T
    return Windows(chosen[:, 0], chosen[:, 1], max(spans)), allowed


def _main_joints(replay: Replay, members: Sequence[int]) -> list[int]:
    """Joints whose torque the terms are about; others they merely touch."""
    noise = replay.scored.evidence.noise
    parts = [replay.scored.contribution(k) for k in members]
    fall = np.array(
        [sum(p[i] @ p[i] for p in parts) / noise[i] for i in range(len(noise))]
    )
    return np.flatnonzero(fall >= _BYPRODUCT * fall.max(initial=0.0)).tolist()


def _removed(before: Array, after: Array) -> float:
    whole = np.median(before)
    return float(1.0 - np.median(after) / whole) if whole > 0 else 0.0


def _resampled(
    blocks: NDArray[np.intp], rng: np.random.Generator
) -> Iterator[NDArray[np.intp]]:
    """Indices of windows, drawn block by block."""
    members = [np.flatnonzero(blocks == b) for b in range(blocks.max() + 1)]
    for _ in range(_RESAMPLES):
        drawn = rng.integers(len(members), size=len(members))
        yield np.concatenate([members[b] for b in drawn])
