"""The simulator run along measured motions, from many of their states.

Both sides of a comparison have the corrected background: links and declared friction
as they were fitted together with all effects. A replay starts in many measured states
of motions that no step has seen, and is driven by the measured torque; open loop, it
departs from the measured motion by what the simulator lacks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.answer.simulator import corrected, scored_effects
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.split import between, split
from hybrid.effects import Effect
from hybrid.plant.rollout import Windows, rollout
from hybrid.robot import Robot
from hybrid.signals import Motion

HORIZONS = (0.1, 0.5, 2.0)  # s
_USUAL = 0.5  # s
_MOST_WINDOWS = 24
_FEWEST_WINDOWS = 3
_STEPS = 1e-3, 3e-4, 1e-4  # s
_IDLE = 0.01  # of the largest torque squared; windows below do not show a term
_LOST = np.pi  # rad; a replay that is so far off is lost, however far


class Replay:
    """Windows of the motions kept for scoring, and the simulator run along them.

    Args:
        scored: What was found.
        most: Most windows; they start half a second apart or more, or a tenth where few
            are that long.

    Attributes:
        scored: What was found.
        effects: Its terms, with the gains that they were scored with.
        motions: The motions kept for scoring at decimated samples, with their
            measured torque, filtered.
        windows: W windows along them, as long as the longest horizon.
        fits: Where a window's samples up to each horizon are all usable, shape (H, W).
    """

    def __init__(self, scored: Explanation, *, most: int = _MOST_WINDOWS) -> None:
        self.scored = scored
        self.effects = scored_effects(scored)
        gap = scored.gap
        learn = split(gap)
        unseen = ~learn & between(gap, learn)
        self.motions, usable, self._start = _motions(gap, unseen)
        self._spans = [max(1, round(h * gap.rate)) for h in HORIZONS]
        self.windows, self.fits = _windows(usable, self._spans, most)
        self._known: dict[tuple[frozenset[int], float], Array] = {}

    def squares(self, terms: Iterable[int], *, step: float | None = None) -> Array:
        """Mean squares of the motion error with some terms.

        Args:
            terms: Indices of the terms that the simulator has.
            step: Longest physics step, [s]; :attr:`step` by default.

        Returns:
            For each horizon, window and joint, shape (H, W, n), [rad²].
        """
        return self._squares(self._off(frozenset(terms), step or self.step))

    def squares_of(self, effects: Sequence[Effect]) -> Array:
        """The same with any effects: candidates that torque alone cannot settle."""
        return self._squares(self._run(effects, self.step))

    @cached_property
    def step(self) -> float:
        """Longest physics step with which no replay with all terms diverges, [s].

        Stiff friction on light links needs a short one. If each of them diverges, that
        is not the step's fault, and the longest one serves.
        """
        for step in _STEPS:
            if np.isfinite(self._off(self.all_terms, step)).all():
                return step
        return _STEPS[0]

    def _off(self, terms: frozenset[int], step: float) -> Array:
        """Motion error with some terms, replayed once for each step."""
        if (terms, step) not in self._known:
            effects = [self.effects[k] for k in sorted(terms)]
            self._known[terms, step] = self._run(effects, step)
        return self._known[terms, step]

    def _run(self, effects: Sequence[Effect], step: float) -> Array:
        """Motion error, shape (S + 1, W, n), [rad]; NaN where a replay has diverged."""
        robot, others = corrected(self.scored, effects)
        shown = rollout(robot, others, self.motions, self.windows, step=step)
        return shown - self.windows.of([m.q for m in self.motions])

    def _squares(self, off: Array) -> Array:
        """Mean squares of it up to each horizon, shape (H, W, n), [rad²]."""
        off = np.where(np.isnan(off), _LOST, np.clip(off, -_LOST, _LOST))
        total = np.cumsum(off[1:] ** 2, axis=0)
        return np.stack([total[s - 1] / s for s in self._spans])

    @property
    def all_terms(self) -> frozenset[int]:
        """Indices of all terms."""
        return frozenset(range(len(self.effects)))

    def has(self, horizon: float) -> bool:
        """Whether enough windows are as long as a horizon."""
        return len(self.fit(horizon)) >= _FEWEST_WINDOWS

    @cached_property
    def horizon(self) -> float | None:
        """Half a second, or less if few windows are that long; nothing if none is."""
        return next((h for h in (_USUAL, HORIZONS[0]) if self.has(h)), None)

    def fit(self, horizon: float) -> NDArray[np.intp]:
        """Windows that are as long as a horizon, shape (W',)."""
        return np.flatnonzero(self.fits[HORIZONS.index(horizon)])

    def where(self, members: Iterable[int], horizon: float) -> NDArray[np.intp]:
        """Windows that fit a horizon and in which some terms act, shape (W',)."""
        h, gap = HORIZONS.index(horizon), self.scored.gap
        acting = np.zeros(len(gap.fold))
        for k in members:
            for i, part in enumerate(self.scored.contribution(k)):
                rows = self.scored.evidence.rows[i]
                acting[rows] += part**2 / self.scored.evidence.noise[i]
        sums = np.concatenate([[0.0], np.cumsum(acting)])
        first = self._start[self.windows.motion] + self.windows.sample
        share = sums[np.minimum(first + self._spans[h], len(acting))] - sums[first]
        share = np.where(self.fits[h], share, 0.0)
        return np.flatnonzero(self.fits[h] & (share >= _IDLE * share.max(initial=0.0)))

    def error(self, squares: Array, joints: Sequence[int], horizon: float) -> Array:
        """RMS over joints and time in each window, shape (W,), [rad]."""
        of = squares[HORIZONS.index(horizon)][:, list(joints)]
        return np.asarray(np.sqrt(of.mean(axis=1)))

    def blocks(self, pick: NDArray[np.intp], horizon: float) -> NDArray[np.intp]:
        """Block of each of some windows, shared by those that overlap."""
        span, w = self._spans[HORIZONS.index(horizon)], self.windows
        block = np.stack([w.motion[pick], w.sample[pick] // span], axis=1)
        return np.unique(block, axis=0, return_inverse=True)[1].ravel()


def courses(scored: Explanation) -> tuple[Array, Array]:
    """The motions as simulators make them, from the measured state every half second.

    Unlike a score it runs along all samples, those of the fit among them.

    Args:
        scored: What was found.

    Returns:
        Position at the samples of the gap by the simulator as it stands and by the one
        with what was found, shape (M, n), [rad]; NaN where nothing can be replayed.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    gap = scored.gap
    motions, usable, start = _motions(gap, np.ones(len(gap.fold), dtype=np.bool_))
    span = round(_USUAL * gap.rate)
    motion, sample, _ = _starts(usable, span).T
    found = []
    for robot, effects in ((gap.robot, ()), corrected(scored, scored_effects(scored))):
        course = np.full_like(gap.left, np.nan)
        if len(motion):
            windows = Windows(motion, sample, span)
            at = start[motion] + sample + np.arange(span + 1)[:, None]
            course[at] = _steady(robot, effects, motions, windows)
        found.append(course)
    return found[0], found[1]


def _steady(
    robot: Robot,
    effects: Sequence[Effect],
    motions: Sequence[Motion],
    windows: Windows,
) -> Array:
    """A rollout with the longest step that does not diverge, or the shortest."""
    for step in _STEPS:
        shown = rollout(robot, effects, motions, windows, step=step)
        if np.isfinite(shown).all():
            break
    return shown


def _motions(
    gap: Gap, wanted: NDArray[np.bool_]
) -> tuple[tuple[Motion, ...], list[NDArray[np.bool_]], NDArray[np.intp]]:
    """Decimated motions that hold wanted samples.

    Returns:
        The motions; which of their samples these are; and their first samples in the
        gap.
    """
    motions, usable, start = [], [], []
    for r, (m, _, sampler) in enumerate(gap):
        own, keep = (
            np.flatnonzero(gap.trajectory == r),
            slice(None, None, sampler.factor),
        )
        fresh = wanted[own] & m.mask[keep]
        # All windows share one clock.
        if fresh.any() and np.isclose(gap.rate, m.rate / sampler.factor, 1e-4):
            warm = None if m.temperature is None else m.temperature[keep]
            tau = gap.measured[own]
            parts = {
                name: getattr(m, name)[keep] for name in ("t", "q", "v", "a", "mask")
            }
            motions.append(replace(m, tau=tau, asked=None, temperature=warm, **parts))
            usable.append(fresh)
            start.append(own[0])
    return tuple(motions), usable, np.array(start, dtype=np.intp)


def _windows(
    usable: Sequence[NDArray[np.bool_]], spans: Sequence[int], most: int
) -> tuple[Windows, NDArray[np.bool_]]:
    """Windows that fit half a second, or a tenth if few do, one after the other."""
    usual, short = (spans[HORIZONS.index(h)] for h in (_USUAL, HORIZONS[0]))
    found = _starts(usable, usual)
    if few := len(found) < _FEWEST_WINDOWS:
        found = _starts(usable, short)
    if len(found) > most:
        found = found[np.linspace(0, len(found) - 1, most).round().astype(int)]
    motion, sample, run = found.T
    fits = run > np.array(spans)[:, None]
    if few:  # longer ones would hold each other
        fits[1:] = False
    return Windows(motion, sample, max(spans)), fits


def _starts(usable: Sequence[NDArray[np.bool_]], span: int) -> NDArray[np.intp]:
    """Motion and first sample of each window, and how many are usable from there on."""
    found = []
    for r, fresh in enumerate(usable):
        # How many usable samples in a row follow each one.
        gaps = np.append(np.flatnonzero(~fresh), len(fresh))
        run = gaps[np.searchsorted(gaps, np.arange(len(fresh)))] - np.arange(len(fresh))
        k = 0
        while k < len(fresh):
            if run[k] > span:
                found.append((r, k, run[k]))
                k += span
            else:
                k += max(int(run[k]), 1)
    return np.array(found, dtype=np.intp).reshape(-1, 3)
