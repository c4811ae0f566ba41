"""The gap: measured torque less the torque that the simulator needs."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import groupby
from math import prod

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import Effect, Scale
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.filters import LOWER_BAND, butterworth

Columns = Mapping[int, Array]  # joint -> columns, shape (M, p)

_VISIBLE = 0.7  # of the cut-off: an oscillation above it is lost in noise
_FRICTION_BAND = 25.0  # Hz; band in which a reversal of dry friction is visible
_KEPT = 500  # columns of effects, which a search asks for again and again
_AT_ONCE = 8  # signals that are filtered
_SMALL = 0.01  # of the typical gain, step of a finite difference


@dataclass(frozen=True, eq=False)
class Gap:
    """Measured less simulated torque at M samples, filtered, decimated and stacked."""

    robot: Robot  # the simulator that is diagnosed
    # With the simulated torque, of about twelve samples in a period of the cut-off or
    # the rate of the log. Columns of the measured torque would explain its noise.
    motions: tuple[Motion, ...]
    bodies: tuple[RigidBody, ...]  # of the simulator, along each motion
    cutoff: float  # of the low-pass filter, [Hz]
    period: float  # time between two samples of the logs, [s]
    left: Array  # the gap, shape (M, n), [N·m]
    moving: Mask  # whether the joint moves and the mask allows it, shape (M, n)
    # Cross-validation fold of each sample, shape (M,): blocks of 3 s or less. What acts
    # in one trajectory only is in several folds.
    fold: Index
    trajectory: Index  # recording of each sample, shape (M,)
    notes: tuple[str, ...] = ()  # which samples are not used, and why
    # Torque of a healthy arm that was subtracted from the logs before, along each
    # motion, shape (N, n), [N·m]; empty without one.
    healthy: tuple[Array, ...] = ()
    joins: tuple[Gap, ...] = ()  # whose motions it has, in order; empty if measured
    # Frequency above which positions hold more noise than motion, [Hz]; the cut-off by
    # default.
    position_cutoff: float = 0.0
    _kept: dict[Hashable, Columns] = field(default_factory=dict, init=False)

    @cached_property
    def samplers(self) -> list[Sampler]:
        """Filter and decimator of each motion."""
        return [Sampler.for_rate(m.rate, self.cutoff) for m in self.motions]

    @property
    def torque_is_filtered(self) -> bool:
        """Whether the logged torque lacks frequencies that the motion has."""
        return self.cutoff < self.position_cutoff

    def lower_cutoff(self, part: float = LOWER_BAND) -> float:
        """Cut-off of derivatives of positions, a part of that of positions, [Hz]."""
        # Above half of it they are mostly noise.
        return min(self.cutoff, part * max(self.position_cutoff, self.cutoff))

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """Rated torque and speed of each joint."""
        # Where the file states no torque limit, the rated torque is at least the
        # largest measured one. Where it states no speed limit, the rated speed is at
        # most the largest measured one.
        known = joint_scales(self.robot)
        torque, speed = np.array([(s.torque, s.speed) for s in known]).T
        seen, fastest = (np.abs(x).max(axis=0) for x in (self.measured, self.sampled.v))
        rated = np.isfinite(self.robot.tau_max)
        limited = np.isfinite(self.robot.v_max) | (fastest == 0)
        torque = np.where(rated, torque, np.maximum(torque, seen))
        speed = np.where(limited, speed, np.minimum(speed, fastest))
        return tuple(map(Scale, torque.tolist(), speed.tolist()))

    @cached_property
    def sampled(self) -> Motion:
        """The motions at the decimated samples, stacked."""

        def stack(name: str) -> Array:
            return np.concatenate([getattr(m, name)[:: s.factor] for m, _, s in self])

        t, q, v, a, tau, mask = map(stack, ("t", "q", "v", "a", "tau", "mask"))
        known = all(m.temperature is not None for m in self.motions)
        warm = stack("temperature") if known else None
        return Motion(t, q, v, a, tau, mask.astype(bool), warm, self.robot.joints)

    @cached_property
    def measured(self) -> Array:
        """Measured torque, filtered as the gap is, shape (M, n), [N·m]."""
        return np.concatenate([sampler(m.tau) for m, _, sampler in self]) + self.left

    @cached_property
    def subtracted(self) -> Array | None:
        """Torque of the healthy arm, filtered as the gap is, (M, n), [N·m], or None."""
        parts = [s(x) for s, x in zip(self.samplers, self.healthy, strict=False)]
        return np.concatenate(parts) if parts else None

    @cached_property
    def load(self) -> Array:
        """Simulated torque on the links, without rotor and friction, (M, n), [N·m]."""
        return np.concatenate([body.load[:: s.factor] for _, body, s in self])

    @property
    def rate(self) -> float:
        """Decimated samples per second, [Hz]."""
        return self.motions[0].rate / self.samplers[0].factor

    def columns(self, effect: Effect, *, lower_band: bool | None = None) -> Columns:
        """Torque per unit of each gain, filtered as the gap is.

        The columns are the derivative at gains of zero. An effect that changes signals
        is not linear in its gains: at other gains its columns are corrected, so that
        columns times gains is the whole change of torque. An effect that differentiates
        signals, or oscillates above the visible band, is evaluated on the
        :attr:`lower_band`, unless this is given.

        Returns:
            Columns at each joint that the effect's torque reaches, shape (M, p).
        """
        if effect.reports and not effect.gain_values.any():
            # Its columns at zero do not contain the friction, which a log does.
            scale = self.scales[effect.joints[-1]]
            small = {g.name: _SMALL * g.scaled(scale).typical for g in effect.gains}
            effect = effect.at(small)
        if not effect.holds(self.motions):
            none = np.zeros((len(self.left), len(effect.gains)))
            return dict.fromkeys(effect.reaches(self.robot.size), none)
        if lower_band is None:
            lower_band = effect.differentiates or self.is_above_band(effect)
        return self._cached(effect, lower_band)

    def _cached(self, effect: Effect, lower_band: bool) -> Columns:
        """See :meth:`columns`; whether or not the recordings allow the law."""
        gains = effect.gains if effect.linearised or effect.steep else ()
        values = tuple(effect.values[x.name] for x in (*gains, *effect.shapes))
        key, kept = (type(effect), effect.joints, values, lower_band), self._kept
        if key not in kept:
            if len(kept) == _KEPT:
                kept.pop(next(iter(kept)))
            kept[key] = self._evaluated(effect, lower_band)
        return kept[key]

    def _evaluated(self, effect: Effect, lower_band: bool) -> Columns:
        """See :meth:`columns`; shape (M, p) at each joint."""
        if self.joins:  # they may keep theirs from another join
            return stacked([x._cached(effect, lower_band) for x in self.joins])
        gains, parts = effect.gain_values, []
        whole = self.reported if effect.reports else self
        lower = self.lower_band_reported if effect.reports else self.lower_band
        for motion, body, _ in lower if lower_band else whole:
            columns = self._first(effect, motion, body)
            if effect.linearised and gains.any():
                rest = self._change(effect, motion, body) - columns @ gains
                columns = columns + rest[:, :, None] * gains / (gains @ gains)
            parts.append(columns)
        reached = effect.reaches(self.robot.size)
        return dict(zip(reached, self.filtered(parts).swapaxes(0, 1), strict=True))

    def filtered(self, signals: Sequence[Array]) -> Array:
        """Signals along each motion, (N, r, p), as the gap is filtered, (M, r, p)."""
        # A few signals of motions of one length are filtered at once, which halves the
        # time of one signal. More of them would leave the processor's cache.
        each = [(x.T, s) for x, s in zip(signals, self.samplers, strict=True)]
        parts = list[Array]()  # (p, r, M): time is last, as in the filter
        for (shape, sampler), same in groupby(each, lambda x: (x[0].shape, x[1])):
            alike, count = [x for x, _ in same], -(-_AT_ONCE // prod(shape[:-1]))
            for k in range(0, len(alike), count):
                parts += [*sampler(np.stack(alike[k : k + count]), axis=-1)]
        return np.concatenate(parts, axis=-1).T

    def is_above_band(self, effect: Effect) -> bool:
        """Whether an effect oscillates at a frequency above the visible band."""
        frequency = np.mean([effect.frequency(x) for x in self.bodies])
        return bool(frequency > _VISIBLE * self.cutoff)

    def _first(self, effect: Effect, motion: Motion, body: RigidBody) -> Array:
        """Derivative of the torque with respect to each gain, shape (N, r, p)."""
        # For an effect that changes the observed motion it includes the change of the
        # torque of rotor, damping and spring.
        columns = effect.columns(motion, body)
        if not effect.observes or effect.steep:
            return columns
        reached, robot = list(effect.reaches(self.robot.size)), self.robot
        known = robot.joint_torque(motion.q, motion.v, motion.a)
        for k, g in enumerate(effect.gains):
            small = _SMALL * g.typical
            none = dict.fromkeys((x.name for x in effect.gains), 0.0)
            seen = effect.at(none | {g.name: small}).observe(motion, body)
            drive = robot.joint_torque(seen.q, seen.v, seen.a) - known
            columns[:, :, k] += drive[:, reached] / small
        return columns

    def _change(self, effect: Effect, motion: Motion, body: RigidBody) -> Array:
        """Change of the simulated torque by an effect that changes signals, (N, r)."""
        reached = list(effect.reaches(self.robot.size))
        if effect.reports:
            known = motion.tau[:, reached]
            return effect.report(motion.t, known) - known
        seen = effect.observe(motion, body)
        tau = simulated_torque(self.robot, seen, RigidBody(self.robot.chain, seen))
        return (tau - motion.tau)[:, reached]

    @cached_property
    def reported(self) -> list[tuple[Motion, RigidBody, Sampler]]:
        """Motions, bodies and samplers with the whole torque that drives report."""
        if not self.healthy:
            return list(self)
        each = zip(self, self.healthy, strict=True)
        return [(replace(m, tau=m.tau + x), body, s) for (m, body, s), x in each]

    @cached_property
    def lower_band(self) -> list[tuple[Motion, RigidBody, Sampler]]:
        """Motions, bodies and samplers in the lower half of the band."""
        # A further derivative of a noisy position is mostly noise. The gain of a noisy
        # column would come out too small.
        parts = []
        for m, body, sampler in self:
            low = partial(butterworth, rate=m.rate, cutoff=self.lower_cutoff())
            # The torque is filtered: simulated again, its dry friction would reverse
            # at other times.
            slow = replace(m, q=low(m.q), v=low(m.v), a=low(m.a), tau=low(m.tau))
            own = RigidBody(self.robot.chain, slow, slopes_of=body)
            parts.append((slow, own, sampler))
        return parts

    @cached_property
    def lower_band_reported(self) -> list[tuple[Motion, RigidBody, Sampler]]:
        """:attr:`lower_band` for effects that change the reported torque."""
        # Declared dry friction has no noise, and keeps its band up to 25 Hz; so does
        # the torque of a healthy arm, which is mostly friction.
        parts, band = [], self.lower_cutoff()
        more = self.healthy or [np.zeros(1)] * len(self.motions)
        each = zip(self.motions, more, self.lower_band, strict=True)
        for m, healthy, (slow, body, sampler) in each:
            dry = self.robot.dry_friction(m.v)
            low, kept = partial(butterworth, rate=m.rate), dry + healthy
            if self.cutoff >= _FRICTION_BAND:
                kept = low(kept, cutoff=max(band, _FRICTION_BAND))
            slow = replace(slow, tau=slow.tau + kept - low(dry, cutoff=band))
            parts.append((slow, body, sampler))
        return parts

    def __iter__(self) -> Iterator[tuple[Motion, RigidBody, Sampler]]:
        """Each motion with its rigid body and its sampler."""
        return zip(self.motions, self.bodies, self.samplers, strict=True)


def stacked(columns: Sequence[Columns]) -> Columns:
    """Columns of several gaps at the same joints, one after the other."""
    return {j: np.concatenate([x[j] for x in columns]) for j in columns[0]}
