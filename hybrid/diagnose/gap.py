"""The gap: torque that the arm needed and its simulator does not explain."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.faults import Faults, find_faults
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.effect import Scale
from hybrid.errors import RecordingError
from hybrid.identify.data import prepare_motions
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler
from hybrid.signals.filters import butterworth, filter_reach

Columns = Mapping[int, Array]  # joint -> columns, shape (M, p)

_STANDING = 0.01  # of the highest speed
_SLOWEST = 0.002  # rad/s or m/s; a servo at rest seems to move as fast
# Periods of the cut-off for which a filter spreads how declared dry friction passed
# rest, which is the solver's own.
_REST = 0.7
_CALM = 0.5  # of the cut-off
_SHOWN = 0.7  # of the cut-off: what swings faster does so in noise
_TURNING = 25.0  # Hz; no dry friction turns round more quickly than that shows
_FAR = 10.0  # deviations of noise: so far off, torque is what the log says
_NORMAL = 1.4826  # standard deviation over median size
_BLOCK_SECONDS = 3.0
_SHORTEST_BLOCK = 0.5
_MOST_FOLDS = 8
_FEWEST_MOVING = 0.05  # of all samples
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

    @property
    def samplers(self) -> list[Sampler]:
        """Filter and decimation of each motion."""
        return [Sampler.for_rate(m.rate, self.cutoff) for m in self.motions]

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """Rated torque and speed of each joint.

        A drive of which the file states no limit gives what the logs show, at least.
        """
        seen = np.abs(self.measured).max(axis=0)
        unstated = ~np.isfinite(self.robot.tau_max)
        return tuple(
            replace(s, torque=max(s.torque, float(x))) if free else s
            for s, x, free in zip(joint_scales(self.robot), seen, unstated, strict=True)
        )

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

        Of another speed than the encoder's, with what rotor and damping make of it.
        """
        columns = effect.columns(motion, body)
        if not effect.observes or effect.steep:
            return columns
        reached, robot = list(effect.reaches(self.robot.size)), self.robot
        for k, g in enumerate(effect.gains):
            small = _SMALL * g.typical
            none = dict.fromkeys((x.name for x in effect.gains), 0.0)
            seen = effect.at(none | {g.name: small}).observe(motion, body)
            v, a = seen.v - motion.v, seen.a - motion.a
            drive = (robot.chain.armature * a + robot.damping * v)[:, reached]
            columns[:, :, k] += drive / small
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
            dry = self.robot.frictionloss * np.sign(m.v)
            low = partial(butterworth, dry, rate=m.rate)
            usual = low(cutoff=_CALM * self.cutoff)
            turned = dry if self.cutoff < _TURNING else low(cutoff=_TURNING)
            if _CALM * self.cutoff < _TURNING:
                slow = replace(slow, tau=slow.tau + turned - usual)
            parts.append((slow, body, sampler))
        return parts

    def __iter__(self) -> Iterator[tuple[Motion, RigidBody, Sampler]]:
        return zip(self.motions, self.bodies, self.samplers, strict=True)


def measure_gap(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    correct: Callable[[Motion], Motion] | None = None,
) -> Gap:
    """Compare a simulator with logs, torque by torque.

    Args:
        robot: The simulator as it stands, with the friction that its file declares.
        recordings: Logs of the real arm, or motions made from such.
        cutoff: Cut-off, [Hz]; from the spectrum if not given.
        correct: What to do to each motion first; see :mod:`.convention`.

    Raises:
        IdentificationError: There is no recording.
        RecordingError: A recording does not fit the arm, or has no torque.
    """
    motions, cutoff = prepare_motions(robot, recordings, cutoff)
    motions = [correct(m) for m in motions] if correct else motions
    for motion in motions:
        if not np.isfinite(motion.tau).all():
            raise RecordingError(
                f"{motion.source or 'recording'}: no torque; valid is a log of time, "
                "positions and torques"
            )
    faults = [_faults(x, m, cutoff) for x, m in zip(recordings, motions, strict=True)]
    motions = [
        replace(m, mask=m.mask & ~f.posture)
        for m, f in zip(motions, faults, strict=True)
    ]
    speeds = [np.abs(m.v[m.mask]) for m in motions if m.mask.any()]
    fastest = np.max([x.max(axis=0) for x in speeds], axis=0, initial=0.0)
    bodies = tuple(RigidBody(robot.chain, m) for m in motions)
    simulated, left, moving, fold, trajectory = [], [], [], [], []
    for r, (motion, body) in enumerate(zip(motions, bodies, strict=True)):
        sampler = Sampler.for_rate(motion.rate, cutoff)
        tau = simulated_torque(robot, motion, body)
        left.append(sampler(motion.tau - tau))
        asked = _asked(motion, tau, cutoff)
        simulated.append(replace(motion, tau=tau, asked=asked, number=r))
        v = motion.v[:: sampler.factor]
        usable = sampler.keep(motion.mask)[:, None]
        usable = usable & ~faults[r].torque[:: sampler.factor]
        slow = np.abs(v) <= np.maximum(_STANDING * fastest, _SLOWEST)
        slow[1:] |= v[1:] * v[:-1] < 0
        reach = _REST / cutoff * motion.rate / sampler.factor
        resting = robot.frictionloss > 0
        slow[:, resting] = _around(slow[:, resting], round(reach))
        moving.append(~slow & usable)
        trajectory.append(np.full(len(v), r))
        t = motion.t[:: sampler.factor] - motion.t[0]
        fold.append((t // block_seconds(motions)).astype(int))
    of = np.concatenate(trajectory)
    blocks = np.concatenate(fold)
    if len(motions) >= 4:
        blocks = of % _MOST_FOLDS
    else:
        _, blocks = np.unique(of * (blocks.max() + 1) + blocks, return_inverse=True)
        blocks = blocks % _MOST_FOLDS
    return Gap(
        robot, tuple(simulated), bodies, cutoff,
        np.concatenate(left), _worthwhile(np.concatenate(moving)), blocks, of,
        tuple(note for f in faults for note in f.notes),
    )  # fmt: skip


def _asked(motion: Motion, simulated: Array, cutoff: float) -> Array:
    """Torque as simulated, or as measured where that is far off, shape (N, n), [N·m].

    Noise of the measured torque is in the gap as well; a column that held it would
    seem to explain it.
    """
    if not np.isfinite(cutoff):
        return motion.tau
    low = partial(butterworth, motion.tau - simulated, rate=motion.rate)
    slow = low(cutoff=_CALM * cutoff)
    rough = np.abs(low(cutoff=cutoff) - slow)
    usable = motion.mask | ~motion.mask.any()
    far = _FAR * _NORMAL * np.median(rough[usable], axis=0)
    return np.where(np.abs(slow) > far, motion.tau, simulated)


def _faults(recording: Recording | Motion, motion: Motion, cutoff: float) -> Faults:
    """Faults on the samples of a motion, and as far as the filter carries them."""
    N, n = motion.tau.shape
    if isinstance(recording, Motion):
        return Faults(np.zeros(N, dtype=bool), np.zeros((N, n), dtype=bool), ())
    found = find_faults(recording.in_order(motion.joints))
    near = np.clip(np.searchsorted(recording.t, motion.t), 0, len(recording.t) - 1)
    both = np.column_stack([found.posture, found.torque])[near]
    reach = 0
    if np.isfinite(cutoff):
        reach = filter_reach(cutoff / motion.rate, order=5, tolerance=1e-3)
    both = _around(both, reach)
    return replace(found, posture=both[:, 0], torque=both[:, 1:])


def _around(flags: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Flags, shape (M, k), and what is within reach of them, in samples."""
    window, near = np.ones(2 * reach + 1), np.zeros_like(flags)
    for j in np.flatnonzero(flags.any(axis=0)):
        # Not mode "same": that is as long as the longer of the two.
        near[:, j] = np.convolve(flags[:, j], window)[reach : -reach or None] > 0.5
    return near


def _worthwhile(moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without the joints that hardly move or whose torque is hardly measured."""
    return np.asarray(moving & (moving.mean(axis=0) > _FEWEST_MOVING))


def block_seconds(motions: Sequence[Motion]) -> float:
    """Length of the blocks that trajectories are cut into, [s].

    Three seconds; less where that leaves fewer than eight of them.
    """
    total = sum(float(m.t[-1] - m.t[0]) for m in motions)
    return float(np.clip(total / _MOST_FOLDS, _SHORTEST_BLOCK, _BLOCK_SECONDS))


def simulated_torque(robot: Robot, motion: Motion, body: RigidBody) -> Array:
    """Torque that the simulator's drives need along a motion, shape (N, n), [N·m]."""
    return (
        body.load
        + robot.chain.armature * motion.a
        + robot.damping * motion.v
        + robot.frictionloss * np.sign(motion.v)
    )
