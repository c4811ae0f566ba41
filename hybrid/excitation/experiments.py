"""Ready-made experiments: each reference reveals one kind of effect.

A ladder of speeds shows friction, micro-reversals show presliding and backlash, static
poses show gravity, a multisine shows delay and elasticity, and one path at several
speeds separates inertia, friction and gravity. All but the last stay within 80 % of the
robot file's limits; an :class:`.ExcitationError` names a limit that prevents a motion.
"""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import ExcitationError
from hybrid.excitation.constraints import Limits, MotionLimits, TorqueLimits
from hybrid.excitation.path import Path, quintic, uniform
from hybrid.plant.reference import Reference
from hybrid.robot.robot import Robot

_PAUSE = 0.5  # s, at rest between two parts of an experiment
_RAMP_ACCELERATION = 1.5  # peak while the speed rises by one unit in unit time
_LADDER = np.geomspace(0.01, 0.9, 8)  # of a joint's speed limit
_AMPLITUDES = 0.001, 0.002, 0.005, 0.01, 0.02  # rad, half strokes of small reversals
_REPEATS, _PERIOD = 3, 2.0  # full cycles at each, s
_BAND = 0.2, 5.0  # Hz, of a multisine
_QUINTIC_SPEED, _QUINTIC_ACCELERATION = 1.875, 5.7735  # peaks of a unit move


def at_speeds(
    robot: Robot, reference: Reference, factors: Sequence[float] = (0.5, 1.0, 2.0)
) -> list[Reference]:
    """The same path at multiples of its speed, each at the rate of the reference.

    The limits of the robot's file are kept.
    """
    found, curve = [], quintic(reference.t, reference.q, reference.v, reference.a)
    for factor in factors:
        t = uniform(float(reference.t[-1]) / factor, reference.rate)
        inner = np.minimum(t * factor, reference.t[-1])
        scaled = (np.asarray(curve(inner, nu=k)) * factor**k for k in range(3))
        found.append(checked(robot, Reference(t, *scaled), Limits.of(robot, fill=1.0)))
    return found


def speed_ladder(
    robot: Robot,
    joint: str | int,
    *,
    posture: Array | None = None,
    longest: float = 4.0,
    rate: float = 500.0,
) -> Reference:
    """One joint forth and back at eight constant speeds, from 1 % to 90 % of its limit.

    Args:
        robot: The arm.
        joint: Joint that moves.
        posture: Position of the other joints and centre of this one, shape (n,), [rad];
            the middle of the range by default.
        longest: Longest time at one speed, [s].
        rate: Samples per second, [Hz].
    """
    limits, home = _settings(robot, posture)
    j = robot.joint_index(joint)
    room = 2 * min(home[j] - limits.low[j], limits.high[j] - home[j])
    walk, along = Walk(home), np.eye(robot.size)[j]
    for speed in (_LADDER * limits.speed[j]).tolist():
        hardest = _RAMP_ACCELERATION * speed / limits.usable_acceleration[j]
        ramp = max(hardest, 0.1)
        stroke, least = min(0.98 * room, speed * (ramp + longest)), 1.2 * speed * ramp
        if stroke < least:
            raise ExcitationError(
                f"{robot.joints[j]} has {room:.3g} rad of room about the posture, and "
                f"{least:.3g} rad are needed to reach {speed:g} rad/s"
            )
        for sign in (1.0, -1.0):
            walk.move(home - sign * stroke / 2 * along, limits)
            walk.wait(_PAUSE)
            walk.cruise(sign * speed * along, ramp, stroke / speed - ramp)
            walk.wait(_PAUSE)
    walk.move(home, limits)
    return checked(robot, walk.reference(rate), limits)


def micro_reversals(
    robot: Robot,
    joint: str | int,
    *,
    posture: Array | None = None,
    rate: float = 500.0,
) -> Reference:
    """One joint forth and back by small angles, from 0.001 to 0.02 rad.

    Args:
        robot: The arm.
        joint: Joint that moves.
        posture: Start of all joints, shape (n,), [rad]; the middle by default.
        rate: Samples per second, [Hz].
    """
    limits, home = _settings(robot, posture)
    along, walk = np.eye(robot.size)[robot.joint_index(joint)], Walk(home)
    for amplitude in _AMPLITUDES:
        for sign in (*(1.0, -1.0) * _REPEATS, 0.0):
            walk.go(home + sign * amplitude * along, _PERIOD / 2)
        walk.wait(_PAUSE)
    return checked(robot, walk.reference(rate), limits)


def static_poses(
    robot: Robot, poses: Array, *, hold: float = 1.0, rate: float = 500.0
) -> Reference:
    """A motion through poses, with a stop in each.

    Args:
        robot: The arm.
        poses: Poses in order, shape (K, n), [rad].
        hold: Time at rest in each pose, above 0, [s].
        rate: Samples per second, [Hz].
    """
    if np.ndim(poses) != 2 or np.shape(poses)[1] != robot.size:
        raise ExcitationError(f"poses of {robot.size} joints are valid")
    limits, walk = Limits.of(robot), Walk(poses[0])
    for goal in poses:
        walk.move(goal, limits)
        walk.wait(hold)
    return checked(robot, walk.reference(rate), limits)


def multisine(
    robot: Robot,
    *,
    duration: float = 20.0,
    fill: float = 0.5,
    posture: Array | None = None,
    seed: int | np.random.Generator = 0,
    rate: float = 500.0,
) -> Reference:
    """A motion of all joints at once, with many frequencies and random phases.

    No two joints have a frequency in common, so their responses can be separated
    (Pintelon and Schoukens 2012, doi 10.1002/9781118287422, chapter 2). Tones lie
    between 0.2 and 5 Hz and have equal accelerations. Both ends are at rest.

    Args:
        robot: The arm.
        duration: Length, [s].
        fill: Share of the limits to use.
        posture: Middle of the motion, shape (n,), [rad]; that of the range by default.
        seed: Seed or generator of the phases.
        rate: Samples per second, [Hz].
    """
    limits, home = _settings(robot, posture)
    lowest, highest = (x * duration for x in _BAND)
    lines = np.arange(max(np.ceil(lowest), 1.0), np.floor(highest) + 1)
    if len(lines) < robot.size or 2 * _BAND[1] >= rate:
        raise ExcitationError(
            f"{len(lines)} tones in {duration:g} s at {rate:g} Hz; valid is one tone "
            "or more for each joint, above 0 and below half the rate"
        )
    rng, t = np.random.default_rng(seed), uniform(duration, rate)
    # A window that rises from 0 to 1 and falls again, with two derivatives.
    fade = min(1.0, duration / 4)
    knots = np.array([0.0, fade, duration - fade, duration])
    window = quintic(knots, np.array([0.0, 1.0, 1.0, 0.0]), *np.zeros((2, 4)))
    w0, w1, w2 = (np.asarray(window(t, nu=k)) for k in range(3))
    motion = np.zeros((3, len(t), robot.size))
    for j in range(robot.size):
        w = 2 * np.pi * lines[j :: robot.size] / duration
        phase = rng.uniform(0, 2 * np.pi, len(w))
        x, dx, ddx = (
            np.sin(np.outer(t, w) + phase + k * np.pi / 2) @ w ** (k - 2.0)
            for k in range(3)
        )
        product = np.stack([w0 * x, w1 * x + w0 * dx, w2 * x + 2 * w1 * dx + w0 * ddx])
        room = min(home[j] - limits.low[j], limits.high[j] - home[j])
        sizes = room, limits.speed[j], limits.usable_acceleration[j]
        peaks = np.abs(product).max(axis=1) / (fill * np.array(sizes))
        motion[:, :, j] = product / peaks.max()
    constraint = TorqueLimits(robot, limits.torque)
    for factor in 0.85 ** np.arange(25):
        q, v, a = factor * motion
        reference = Reference(t, home + q, v, a)
        if not (constraint.excess(path_from_reference(reference)) > 0).any():
            return checked(robot, reference, limits)
    raise ExcitationError(
        "gravity alone takes more torque than allowed at this posture"
    )


def checked(robot: Robot, reference: Reference, limits: Limits) -> Reference:
    """Check a reference against the limits, and return it.

    Raises:
        ExcitationError: It exceeds a limit; the message names limit and joint.
    """
    path, torque = path_from_reference(reference), TorqueLimits(robot, limits.torque)
    for constraint in (MotionLimits(limits, robot.joints), torque):
        worst = constraint.excess(path).max(axis=0, initial=-1.0)
        if (worst > 1e-9).any():
            k = int(worst.argmax())
            raise ExcitationError(
                f"the {constraint.names[k]} is exceeded by {100 * worst[k]:.2g} %; "
                "valid is a slower or smaller motion"
            )
    return reference


def path_from_reference(reference: Reference) -> Path:
    """Samples of a reference, with a jerk of zero, which it does not have."""
    zero = np.zeros_like(reference.q)
    return Path(reference.t, reference.q, reference.v, reference.a, zero)


def _settings(robot: Robot, posture: Array | None) -> tuple[Limits, Array]:
    """Limits, and the checked posture or the middle of the range."""
    limits = Limits.of(robot)
    home = limits.middle if posture is None else np.asarray(posture, dtype=float)
    if home.shape != (robot.size,):
        raise ExcitationError(f"a posture needs {robot.size} values")
    if (home < limits.low).any() or (home > limits.high).any():
        raise ExcitationError("the posture lies outside the position limits")
    return limits, home.copy()


class Walk:
    """A sequence of knots from a pose (n,) at rest, joined by quintic polynomials."""

    def __init__(self, home: Array) -> None:
        self._t, self._q = [0.0], [np.array(home, dtype=float)]
        self._v = [np.zeros(len(home))]

    def reference(self, rate: float) -> Reference:
        """Samples of the motion so far; acceleration is zero at every knot."""
        q, v = np.array(self._q), np.array(self._v)
        curve = quintic(np.array(self._t), q, v, np.zeros_like(q))
        t = uniform(self._t[-1], rate)
        return Reference(t, *(np.asarray(curve(t, nu=k)) for k in range(3)))

    def wait(self, duration: float) -> None:
        """Stand still for a time, [s]."""
        self.go(self._q[-1], duration)

    def go(self, goal: Array, duration: float) -> None:
        """Move to a pose and stop, in a given time, [s]."""
        self._add(duration, goal, np.zeros_like(goal))

    def move(self, goal: Array, limits: Limits) -> None:
        """Move to a pose and stop, with half of the limits."""
        distance = np.abs(goal - self._q[-1])
        if distance.max() < 1e-12:
            return
        by_speed = _QUINTIC_SPEED * distance / (0.5 * limits.speed)
        by_acceleration = np.sqrt(
            _QUINTIC_ACCELERATION * distance / (0.5 * limits.usable_acceleration)
        )
        self.go(goal, float(max(by_speed.max(), by_acceleration.max(), 0.1)))

    def cruise(self, velocity: Array, ramp: float, duration: float) -> None:
        """Accelerate to a velocity, shape (n,), keep it, and stop."""
        self._add(ramp, self._q[-1] + 0.5 * ramp * velocity, velocity)
        self._add(duration, self._q[-1] + duration * velocity, velocity)
        self.go(self._q[-1] + 0.5 * ramp * velocity, ramp)

    def _add(self, duration: float, q: Array, v: Array) -> None:
        self._t.append(self._t[-1] + duration)
        self._q.append(q)
        self._v.append(v)
