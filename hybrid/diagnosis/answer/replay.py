"""The simulator run along measured motions, from many of their states.

Both sides of a comparison have the corrected background: links and declared friction
as they were fitted together with all effects. A replay starts in many measured states
of motions that no step has seen, and is driven by the measured torque; open loop, it
departs from the measured motion by what the simulator lacks. Unstable postures let any
model depart sooner or later: stretches are short, and the same on both sides.
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
from hybrid.diagnosis.gap.faults import stretches
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.split import split, unseen_samples
from hybrid.effects import Effect
from hybrid.plant.rollout import Windows, rollout
from hybrid.regression.problem import part
from hybrid.robot import Robot
from hybrid.signals import Motion

HORIZONS = (0.5, 0.1)  # s; the first of which there are enough stretches
_MOST_WINDOWS, _FEWEST_WINDOWS = 24, 3
_STEPS = 1e-3, 3e-4, 1e-4  # s
_IDLE = 0.01  # of the largest torque squared; windows below do not show a term
_LOST = np.pi  # rad; a replay that is so far off is lost, however far


class Replay:
    """Windows of the motions kept for scoring, and the simulator run along them.

    Args:
        scored: What was found.

    Attributes:
        scored: What was found.
        effects: Its terms, with the gains that they were scored with.
        motions: The motions kept for scoring at decimated samples, with their
            measured torque, filtered.
        horizon: Length of the windows, [s]; nothing if too few stretches are usable.
        windows: W windows along the motions, which do not overlap.
    """

    def __init__(self, scored: Explanation) -> None:
        self.scored = scored
        self.effects = scored_effects(scored)
        gap = scored.gap
        learn = split(gap)
        unseen = unseen_samples(gap, learn)
        self.motions, usable, self._start = _motions(gap, unseen)
        self.horizon, self.windows = windows_of(usable, gap.rate)
        self._known: dict[tuple[frozenset[int], float], Array] = {}

    def squares(self, terms: Iterable[int], *, step: float | None = None) -> Array:
        """Mean squares of the motion error with some terms, shape (W, n), [rad²].

        Args:
            terms: Indices of the terms that the simulator has.
            step: Longest physics step, [s]; :attr:`step` by default.
        """
        return _squares(self._off(frozenset(terms), step or self.step))

    def squares_of(self, effects: Sequence[Effect]) -> Array:
        """The same with any effects."""
        return _squares(self._run(effects, self.step))

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

    @property
    def all_terms(self) -> frozenset[int]:
        """Indices of all terms."""
        return frozenset(range(len(self.effects)))

    def where(self, members: Iterable[int]) -> NDArray[np.intp]:
        """Windows in which some terms act, shape (W',)."""
        acting = np.zeros(len(self.scored.gap.fold))
        for k in members:
            for i, torque in enumerate(self.scored.contribution(k)):
                rows = self.scored.evidence.rows[i]
                acting[rows] += torque**2 / self.scored.evidence.noise[i]
        sums = np.concatenate([[0.0], np.cumsum(acting)])
        first = self._start[self.windows.motion] + self.windows.sample
        last = np.minimum(first + self.windows.samples, len(acting))
        share = sums[last] - sums[first]
        return np.flatnonzero(share >= _IDLE * share.max(initial=0.0))


def _squares(off: Array) -> Array:
    """Mean squares over time of the motion error, shape (W, n), [rad²]."""
    off = np.where(np.isnan(off), _LOST, np.clip(off, -_LOST, _LOST))
    return np.asarray((off[1:] ** 2).mean(axis=0))


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
    span = round(HORIZONS[0] * gap.rate)
    motion, sample = _starts(usable, span).T
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
        own = np.flatnonzero(gap.trajectory == r)
        few = part(m, slice(None, None, sampler.factor))
        fresh = wanted[own] & few.mask
        # All windows share one clock.
        if fresh.any() and np.isclose(gap.rate, m.rate / sampler.factor, 1e-4):
            motions.append(replace(few, tau=gap.measured[own], asked=None))
            usable.append(fresh)
            start.append(own[0])
    return tuple(motions), usable, np.array(start, dtype=np.intp)


def windows_of(
    usable: Sequence[NDArray[np.bool_]], rate: float
) -> tuple[float | None, Windows]:
    """Windows that follow each other in the usable samples of some motions.

    Args:
        usable: Which samples of each motion may be replayed, shape (N,) each.
        rate: Samples per second, [Hz].

    Returns:
        Their length, [s], and the windows; nothing and none if there are too few.
    """
    for horizon in HORIZONS:
        span = max(1, round(horizon * rate))
        found = _starts(usable, span)
        if len(found) >= _FEWEST_WINDOWS:
            few = np.linspace(0, len(found) - 1, min(len(found), _MOST_WINDOWS))
            motion, sample = found[few.round().astype(int)].T
            return horizon, Windows(motion, sample, span)
    none = np.zeros(0, dtype=np.intp)
    return None, Windows(none, none, 0)


def _starts(usable: Sequence[NDArray[np.bool_]], span: int) -> NDArray[np.intp]:
    """Motion and first sample of windows that follow each other, shape (W, 2)."""
    found = [
        (r, k)
        for r, fresh in enumerate(usable)
        for run in stretches(fresh)
        for k in range(run.start, run.stop - span, span)
    ]
    return np.array(found, dtype=np.intp).reshape(-1, 2)
