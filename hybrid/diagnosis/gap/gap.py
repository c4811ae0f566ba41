"""The gap: torque that the arm needed and its simulator does not explain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.effect import Scale
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.filters import butterworth

Columns = Mapping[int, Array]  # joint -> columns, shape (M, p)

_CALM = 0.5  # of the cut-off
_SHOWN = 0.7  # of the cut-off: what swings faster does so in noise
_TURNING = 25.0  # Hz; no dry friction turns round more quickly than that shows
_SMALL = 0.01  # of the usual gain, for a derivative


@dataclass(frozen=True, eq=False)
class Gap:
    """Measured less simulated torque along some motions, filtered and decimated.

    M counts the decimated samples of all motions, stacked.

    Attributes:
        robot: The simulator as it stands.
        motions: Motions at full rate, with the torque that the simulator needs for
            them: columns made from measured torque would explain its noise.
        bodies: The simulator's rigid body along each.
        cutoff: Cut-off of everything filtered, [Hz].
        left: Torque left, shape (M, n), [N·m].
        moving: Where a joint moves and the mask allows, shape (M, n).
        fold: Fold of each sample for scoring, shape (M,): one trajectory, or some
            blocks of 3 s where there are fewer than four trajectories.
        trajectory: Recording of each sample, shape (M,).
        notes: What of the recordings is of no use, in words.
        known: Torque that was taken from the logs beforehand, shape (M, n), [N·m].
    """

    robot: Robot
    motions: tuple[Motion, ...]
    bodies: tuple[RigidBody, ...]
    cutoff: float
    left: Array
    moving: NDArray[np.bool_]
    fold: NDArray[np.intp]
    trajectory: NDArray[np.intp]
    notes: tuple[str, ...] = ()
    known: Array | None = None

    @property
    def samplers(self) -> list[Sampler]:
        """Filter and decimation of each motion."""
        return [Sampler.for_rate(m.rate, self.cutoff) for m in self.motions]

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """Rated torque and speed of each joint.

        A drive of which the file states no limit of torque gives what the logs show, at
        least; one without a limit of speed is as fast as they show, at most as usual.
        """
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
        """The motions at the decimated samples, stacked; t runs on in each."""
        parts = list(zip(self.motions, self.samplers, strict=True))

        def stack(name: str) -> Array:
            return np.concatenate([getattr(m, name)[:: s.factor] for m, s in parts])

        t, q, v, a, tau, mask = map(stack, ("t", "q", "v", "a", "tau", "mask"))
        warm = None
        if all(m.temperature is not None for m in self.motions):
            warm = stack("temperature")
        return Motion(t, q, v, a, tau, mask.astype(bool), warm, self.robot.joints)

    @cached_property
    def measured(self) -> Array:
        """Measured torque, filtered as the gap is, shape (M, n), [N·m]."""
        parts = zip(self.motions, self.samplers, strict=True)
        return np.concatenate([sampler(m.tau) for m, sampler in parts]) + self.left

    @cached_property
    def load(self) -> Array:
        """Torque the simulator says is passed to the links, shape (M, n), [N·m]."""
        parts = zip(self.bodies, self.samplers, strict=True)
        return np.concatenate([body.load[:: s.factor] for body, s in parts])

    @property
    def rate(self) -> float:
        """Decimated samples per second, [Hz]."""
        return self.motions[0].rate / self.samplers[0].factor

    def columns(self, effect: Effect, *, calm: bool | None = None) -> Columns:
        """Torque per unit of each gain, filtered as the gap is.

        First order at gains of zero. Effects that change signals are not linear in
        their gains: at any others they are mended along these, so that they make up
        the whole change.

        Args:
            effect: The effect.
            calm: Whether to make them of :attr:`calm`; by default if it differentiates,
                or swings faster than the band shows: there, only noise does.

        Returns:
            For each joint that the effect's torque reaches, shape (M, p).
        """
        if effect.reports and not effect.gain_values.any():
            # A report is of all torque, friction included: its columns are not.
            scale = self.scales[effect.joints[-1]]
            small = {g.name: _SMALL * g.scaled(scale).typical for g in effect.gains}
            effect = effect.at(small)
        gains = effect.gain_values
        if calm is None:
            calm = effect.differentiates or self.above(effect)
        parts = []
        known = self.late if effect.reports else self.calm
        for motion, body, sampler in known if calm else self:
            if effect.linearised and gains.any():
                first = self._first(effect, motion, body)
                rest = self._change(effect, motion, body) - first @ gains
                along = rest[:, :, None] * gains / (gains @ gains)
                parts.append(sampler(first + along))
            else:
                parts.append(sampler(self._first(effect, motion, body)))
        stacked = np.concatenate(parts)
        reached = effect.reaches(self.robot.size)
        return {j: stacked[:, k] for k, j in enumerate(reached)}

    def above(self, effect: Effect) -> bool:
        """Whether an effect swings, and faster than the band shows."""
        swing = np.mean([effect.frequency(x) for x in self.bodies])
        return bool(swing > _SHOWN * self.cutoff)

    def _first(self, effect: Effect, motion: Motion, body: RigidBody) -> Array:
        """First-order torque per unit of each gain, shape (N, r, p).

        Of another motion than the encoder's, with what rotor, damping and spring make
        of it.
        """
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
        """Change of the simulated torque by an effect on signals, shape (N, r)."""
        reached = list(effect.reaches(self.robot.size))
        if effect.reports:
            return (
                effect.report(motion.t, motion.tau[:, reached]) - motion.tau[:, reached]
            )
        seen = effect.observe(motion, body)
        chain = self.robot.chain
        tau = simulated_torque(self.robot, seen, RigidBody(chain, seen))
        return (tau - motion.tau)[:, reached]

    @cached_property
    def calm(self) -> list[tuple[Motion, RigidBody, Sampler]]:
        """The same from the lower half of the band.

        A further derivative of a noisy position is mostly noise, and a column that is
        takes less than its part.
        """
        parts = []
        for m, sampler in zip(self.motions, self.samplers, strict=True):
            low = partial(butterworth, rate=m.rate, cutoff=_CALM * self.cutoff)
            # Its torque is filtered, not made anew: dry friction would turn elsewhere.
            slow = replace(m, q=low(m.q), v=low(m.v), a=low(m.a), tau=low(m.tau))
            parts.append((slow, RigidBody(self.robot.chain, slow), sampler))
        return parts

    @cached_property
    def late(self) -> list[tuple[Motion, RigidBody, Sampler]]:
        """:attr:`calm` for what reports torque late, with dry friction as it turns.

        That has no noise. It takes its time, but no longer where the band is narrow.
        """
        parts = []
        for m, (slow, body, sampler) in zip(self.motions, self.calm, strict=True):
            dry = self.robot.dry_friction(m.v)
            low = partial(butterworth, dry, rate=m.rate)
            usual = low(cutoff=_CALM * self.cutoff)
            turned = dry if self.cutoff < _TURNING else low(cutoff=_TURNING)
            if _CALM * self.cutoff < _TURNING:
                slow = replace(slow, tau=slow.tau + turned - usual)
            parts.append((slow, body, sampler))
        return parts

    def __iter__(self) -> Iterator[tuple[Motion, RigidBody, Sampler]]:
        return zip(self.motions, self.bodies, self.samplers, strict=True)


def simulated_torque(robot: Robot, motion: Motion, body: RigidBody) -> Array:
    """Torque that the simulator's drives need along a motion, shape (N, n), [N·m]."""
    return (
        body.load
        + robot.joint_torque(motion.q, motion.v, motion.a)
        + robot.dry_friction(motion.v)
    )
