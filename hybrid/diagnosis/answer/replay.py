"""Simulate held-out motions from many of their states, driven by the measured torque.

In open loop the simulated motion departs from the measured one by what the simulator
lacks. All simulators that are compared have the corrected background: links and
declared friction as fitted with all effects. In an unstable posture any model departs
after some time, so windows are short, and the same for all simulators.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.answer.simulator import corrected, scored_effects
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import split, unseen_samples
from hybrid.effects import Effect
from hybrid.inspect.stuck import stretches
from hybrid.plant.rollout import Windows, rollout
from hybrid.regression.problem import part
from hybrid.robot import Robot
from hybrid.signals import Motion

HORIZONS = (0.5, 0.1)  # s, by preference
_MOST_WINDOWS, _FEWEST_WINDOWS = 24, 3
_STEPS = 1e-3, 3e-4, 1e-4  # s
_LEAST_SQUARES = 0.01  # of a term's torque in a window, over those of the best window
_LARGEST_ERROR = np.pi  # rad; larger motion errors count as this one


class Replay:
    """Windows of held-out motions, and simulations along them."""

    def __init__(self, scored: Explanation) -> None:
        self.scored, gap = scored, scored.gap
        self.effects = scored_effects(scored)  # its terms, with the gains scored
        # Decimated motions with their filtered torque.
        held_out = unseen_samples(gap, split(gap))
        self.motions, usable, self._start = _motions(gap, held_out)
        # Length of the W windows, [s]; None if there are too few. They do not overlap.
        self.horizon, self.windows = windows_of(usable, gap.rate)
        self._errors: dict[tuple[str, float], Array] = {}

    def squares_of(
        self, effects: Sequence[Effect], *, step: float | None = None
    ) -> Array:
        """Mean square of the motion error with some effects, shape (W, n), [rad²]."""
        # An error is at most half a turn, as where a simulation diverged.
        error = self._error(effects, step or self.step)[1:]
        error = np.clip(error, -_LARGEST_ERROR, _LARGEST_ERROR)
        error = np.where(np.isnan(error), _LARGEST_ERROR, error)
        return np.asarray((error**2).mean(axis=0))

    @cached_property
    def step(self) -> float:
        """Longest physics step with which no simulation with all terms diverges, [s].

        Stiff friction on light links needs a short step. If the simulation diverges
        with each step, another cause is likely, and the longest step is taken.
        """
        fine = (x for x in _STEPS if np.isfinite(self._error(self.effects, x)).all())
        return next(fine, _STEPS[0])

    def _error(self, effects: Sequence[Effect], step: float) -> Array:
        """Motion error, (S + 1, W, n), [rad], simulated once; NaN where it diverged."""
        key = repr(tuple(effects)), step
        if key not in self._errors:
            robot, others = corrected(self.scored, effects)
            q = rollout(robot, others, self.motions, self.windows, step=step)
            self._errors[key] = q - self.windows.of([m.q for m in self.motions])
        return self._errors[key]

    def windows_with(self, members: Iterable[int]) -> Index:
        """Indices of the windows in which some terms act, shape (W',)."""
        scored, acting = self.scored, np.zeros(len(self.scored.gap.fold))
        for k in members:
            for i, torque in enumerate(scored.contribution(k)):
                acting[scored.evidence.rows[i]] += torque**2 / scored.evidence.noise[i]
        sums = np.concatenate([[0.0], np.cumsum(acting)])
        first = self._start[self.windows.motion] + self.windows.sample
        last = np.minimum(first + self.windows.samples, len(acting))
        share = sums[last] - sums[first]
        return np.flatnonzero(share >= _LEAST_SQUARES * share.max(initial=0.0))


def simulated_positions(scored: Explanation) -> tuple[Array, Array]:
    """Simulate all motions, training samples included, restarted every half second.

    Positions are at the samples of the gap, by the simulator's file and with the
    findings, shape (M, n), [rad]; NaN where there is no window.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    gap = scored.gap
    motions, usable, start = _motions(gap, np.ones(len(gap.fold), dtype=np.bool_))
    span = round(HORIZONS[0] * gap.rate)
    windows = _windows(_starts(usable, span), span)
    at = start[windows.motion] + windows.sample + np.arange(span + 1)[:, None]

    def positions(robot: Robot, effects: Sequence[Effect]) -> Array:
        q = np.full_like(gap.left, np.nan)
        for step in _STEPS if at.size else ():
            q[at] = rollout(robot, effects, motions, windows, step=step)
            if np.isfinite(q[at]).all():
                break
        return q

    found = corrected(scored, scored_effects(scored))
    return positions(gap.robot, ()), positions(*found)


def _motions(gap: Gap, wanted: Mask) -> tuple[tuple[Motion, ...], list[Mask], Index]:
    """Decimated motions that hold wanted samples.

    With a mask of the wanted samples of each, and the first sample of each in the gap.
    """
    motions, usable, start = [], [], []
    for r, (m, _, sampler) in enumerate(gap):
        own = np.flatnonzero(gap.trajectory == r)
        decimated = part(m, slice(None, None, sampler.factor))
        mask = wanted[own] & decimated.mask
        # All windows have the same rate.
        if mask.any() and np.isclose(gap.rate, m.rate / sampler.factor, 1e-4):
            motions.append(replace(decimated, tau=gap.measured[own], asked=None))
            usable.append(mask)
            start.append(own[0])
    return tuple(motions), usable, np.array(start, dtype=np.intp)


def windows_of(usable: Sequence[Mask], rate: float) -> tuple[float | None, Windows]:
    """Windows in the usable samples of motions, (N,) each, and their length, [s].

    There are none, of no length, if they are too few.
    """
    for horizon in HORIZONS:
        span = max(1, round(horizon * rate))
        found = _starts(usable, span)
        if len(found) >= _FEWEST_WINDOWS:
            chosen = np.linspace(0, len(found) - 1, min(len(found), _MOST_WINDOWS))
            return horizon, _windows(found[chosen.round().astype(int)], span)
    return None, _windows(_starts((), 0), 0)


def _windows(starts: Index, span: int) -> Windows:
    motion, sample = starts.T
    return Windows(motion, sample, span)


def _starts(usable: Sequence[Mask], span: int) -> Index:
    """Motion and first sample of windows without overlap, shape (W, 2)."""
    found = [
        (r, k)
        for r, mask in enumerate(usable)
        for run in stretches(mask)
        for k in range(run.start, run.stop - span, span)
    ]
    return np.array(found, dtype=np.intp).reshape(-1, 2)
