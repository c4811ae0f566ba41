"""Replays: a simulator starts in measured states and is driven by measured torque."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.plant.arm import Arm, build_arm, encoder_readings, overrides
from hybrid.plant.lockstep import Lockstep
from hybrid.robot.robot import Robot
from hybrid.signals import Motion

_INVERSE_PASSES = 4  # of Newton's method for the inverse of a report
_DIVERGED = 100.0  # rad/s; a faster trajectory has diverged


@dataclass(frozen=True, eq=False)
class Windows:
    """B windows of motions to replay; a short motion repeats its last sample."""

    motion: Index  # index of the motion of each window, (B,)
    sample: Index  # first sample of each window in its motion, (B,)
    samples: int  # number of samples S after the first

    def of(self, signals: Sequence[Array], factor: int = 1) -> Array:
        """Signals in the windows, shape (factor·S + 1, B, ...).

        Each motion has a signal of shape (factor·(N − 1) + 1, ...), as ``factor`` times
        its samples.
        """
        along = np.arange(factor * self.samples + 1)
        parts = [
            signals[m][np.minimum(factor * k + along, len(signals[m]) - 1)]
            for m, k in zip(self.motion, self.sample, strict=True)
        ]
        return np.stack(parts, axis=1)

    def first(self, signals: Sequence[Array]) -> Array:
        """First sample of the signals in each window, shape (B, ...)."""
        pairs = zip(self.motion, self.sample, strict=True)
        return np.array([signals[m][k] for m, k in pairs])


def rollout(
    robot: Robot,
    effects: Sequence[Effect],
    motions: Sequence[Motion],
    windows: Windows,
    *,
    step: float = 0.001,
) -> Array:
    """Simulate freely from measured states under the measured torque.

    The motors start at their measured position and speed. Elastic deflection, backlash
    and bristles start in the states that follow from the measured motion. Samples are a
    whole number of physics steps apart, of at most ``step``, [s].

    Returns:
        Position that the encoders would show at the samples of each window, shape
        (S + 1, B, n), [rad]; NaN after a replay has diverged.

    Raises:
        EffectError: An effect cannot be simulated.
        HybridError: The arm cannot be built.
    """
    apart = 1.0 / motions[0].rate
    factor = int(np.ceil(apart / step - 1e-9))
    inside = [e for e in effects if not e.reports]
    arm = build_arm(robot, inside, step=apart / factor, integrator="implicitfast")
    torque = windows.of([_delivered(m, effects, factor) for m in motions], factor)
    state = _FreeTrajectories(robot, arm, inside, motions, windows)
    positions = np.empty((windows.samples + 1, *state.q.shape))
    positions[0] = windows.first([m.q for m in motions])
    for k in range(windows.samples):
        for held in torque[k * factor : (k + 1) * factor]:
            state.step(held)
        positions[k + 1] = encoder_readings(inside, state.q, state.v)[0]
        positions[k + 1, state.diverged] = np.nan
    return positions


class _FreeTrajectories(Lockstep):
    """Trajectories that start in motion, each at its own time.

    Attributes:
        diverged: Whether each trajectory has diverged, shape (B,).
    """

    def __init__(
        self,
        robot: Robot,
        arm: Arm,
        effects: Sequence[Effect],
        motions: Sequence[Motion],
        windows: Windows,
    ) -> None:
        """Place every trajectory in the state that follows from its motion."""
        seen = [_motor_motion(robot, effects, motion) for motion in motions]
        pairs = [(m, RigidBody(robot.chain, m)) for m in seen]

        def first(name: str) -> Array:
            return windows.first([getattr(m, name) for m in seen])

        t, q, v, a = map(first, ("t", "q", "v", "a"))
        self.diverged = np.zeros(len(q), dtype=bool)
        super().__init__(arm, effects, q)
        self.recordings = np.array([motions[m].number for m in windows.motion])
        # The semi-implicit step has the speed half a step before the position.
        v = v - arm.model.opt.timestep / 2 * a
        deflections = _deflections(arm, effects, pairs, windows)
        for k, data in enumerate(self._datas):
            data.time = t[k]
            data.qvel[arm.motor] = v[k]
            data.qpos[arm.deflection], data.qvel[arm.deflection] = deflections[:, k]
        if seen[0].temperature is not None:
            self.temperature = first("temperature")
        self._read()
        self.a, self.load = a, windows.first([body.load for _, body in pairs])
        self._laws.resisted = [
            windows.first([e.torque(m, b) for m, b in pairs])
            for e in self._laws.resisting
        ]
        self._laws.remembered = [
            tuple(
                windows.first(each)[:, None]
                for each in zip(*(e.remembered(m) for m in seen), strict=True)
            )
            for e in self._laws.remembering
        ]

    def _check_speed(self) -> None:
        self.diverged |= ~(np.abs(self.v).max(axis=1) < _DIVERGED)
        for k in np.flatnonzero(self.diverged):
            # It continues from rest, and its result is not used.
            self._datas[k].qpos[:] = self._datas[k].qvel[:] = 0.0
            self._datas[k].qacc_warmstart[:] = 0.0
            self.q[k] = self.v[k] = 0.0


def _deflections(
    arm: Arm,
    effects: Sequence[Effect],
    motions: Sequence[tuple[Motion, RigidBody]],
    windows: Windows,
) -> Array:
    """Position and speed of the deflections by the laws of their effects, (2, B, m)."""
    found = np.empty((2, len(windows.motion), len(arm.deflection)))
    joint = arm.model.dof_jntid[arm.deflection]
    limited, stop = arm.model.jnt_limited[joint], arm.model.jnt_range[joint, 1]
    for k, (j, kind) in enumerate(zip(arm.elastic, arm.behind, strict=True)):
        (effect,) = (e for e in effects if e.behind == kind and j in e.joints)
        links = [effect.observe(m, body) for m, body in motions]
        pairs = [(x, m) for x, (m, _) in zip(links, motions, strict=True)]
        twist = windows.first([(x.q - m.q)[:, j] for x, m in pairs])
        speed = windows.first([(x.v - m.v)[:, j] for x, m in pairs])
        if limited[k]:
            twist = np.clip(twist, -stop[k], stop[k])
        found[:, :, k] = twist, speed
    return found


def _motor_motion(robot: Robot, effects: Sequence[Effect], motion: Motion) -> Motion:
    """The true motion of the motors from the measured one."""
    for effect in effects:
        if overrides(effect, "sense"):
            motion = effect.observe(motion, RigidBody(robot.chain, motion))
    return motion


def _delivered(motion: Motion, effects: Sequence[Effect], factor: int) -> Array:
    """Delivered torque from the logged one, shape (factor·(N − 1) + 1, n), [N·m]."""
    from scipy.interpolate import CubicSpline

    samples = factor * (len(motion.t) - 1) + 1
    t = np.linspace(motion.t[0], motion.t[-1], samples)
    torque: Array = motion.tau
    if factor > 1:
        torque = np.asarray(CubicSpline(motion.t, motion.tau)(t))
    for effect in reversed([e for e in effects if e.reports]):
        j = list(effect.joints)
        torque = torque.copy()
        torque[:, j] = _before_report(effect, t, torque[:, j])
    return torque


def _before_report(effect: Effect, t: Array, logged: Array) -> Array:
    """Delivered torque that an effect reports as the logged one, (N, k), [N·m].

    The opposite gain inverts the report to first order; each pass squares the error.
    """
    opposite = effect.at({g.name: -effect.values[g.name] for g in effect.gains})
    torque = opposite.report(t, logged)
    for _ in range(_INVERSE_PASSES):
        torque = torque + opposite.report(t, logged - effect.report(t, torque))
    return torque
