"""Ready-made experiments: each reference reveals one kind of effect.

A ladder of speeds shows friction, micro-reversals show presliding and backlash, static
poses show gravity, a multisine shows delay and elasticity, and one path at several
speeds tells inertia from friction from gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BPoly

from hybrid.arrays import Array
from hybrid.errors import ExcitationError
from hybrid.excitation.constraints import Limits, MotionLimits, TorqueLimits
from hybrid.excitation.knots import Walk
from hybrid.excitation.path import Path, uniform
from hybrid.plant.reference import Reference
from hybrid.robot.robot import Robot

_PAUSE = 0.5  # s, at rest between two parts of an experiment
_RAMP_ACCELERATION = 1.5  # peak while the speed rises by one unit in unit time


def at_speeds(
    robot: Robot,
    reference: Reference,
    factors: Sequence[float] = (0.5, 1.0, 2.0),
    *,
    limits: Limits | None = None,
) -> list[Reference]:
    """The same path at several speeds, each at the rate of the reference.

    Args:
        robot: The arm.
        reference: The path.
        factors: Multiples of its speed.
        limits: Limits to keep; those of the robot file by default.

    Raises:
        ExcitationError: A factor is not above 0, or takes a joint beyond a limit.
    """
    found = []
    for factor in factors:
        if not (np.isfinite(factor) and factor > 0):
            raise ExcitationError(f"factor is {factor:g}, above 0 is valid")
        t = uniform(float(reference.t[-1]) / factor, reference.rate)
        inner = np.minimum(t * factor, reference.t[-1])
        curve = BPoly.from_derivatives(
            reference.t, np.stack([reference.q, reference.v, reference.a], axis=1)
        )
        scaled = (np.asarray(curve(inner, nu=k)) * factor**k for k in range(3))
        found.append(checked(robot, Reference(t, *scaled), limits))
    return found


def speed_ladder(
    robot: Robot,
    joint: str | int,
    *,
    speeds: Sequence[float] | None = None,
    posture: Array | None = None,
    longest: float = 4.0,
    rate: float = 500.0,
    limits: Limits | None = None,
) -> Reference:
    """One joint forth and back at constant speeds, from slow to fast.

    Args:
        robot: The arm.
        joint: Joint that moves.
        speeds: Speeds, [rad/s]; by default eight from 1 % to 90 % of its limit.
        posture: Where the other joints stay and this one is centred, shape (n,),
            [rad]; by default the middle of the range.
        longest: Longest time at one speed, [s].
        rate: Samples per second, [Hz].
        limits: Limits to keep; 80 % of the robot file's by default.

    Raises:
        ExcitationError: A speed is beyond the limit, or needs more room than there is.
    """
    bounds, home, j = _settings(robot, joint, limits, posture)
    fastest, strongest = bounds.speed[j], bounds.usable_acceleration[j]
    wanted = np.geomspace(0.01, 0.9, 8) * fastest if speeds is None else speeds
    room = 2 * min(home[j] - bounds.low[j], bounds.high[j] - home[j])
    knots = Walk(home)
    for speed in map(float, wanted):
        if not 0 < speed <= fastest:
            raise ExcitationError(
                f"speed {speed:g} rad/s of {robot.joints[j]}; valid is above 0 up to "
                f"{fastest:g} rad/s"
            )
        ramp = max(_RAMP_ACCELERATION * speed / strongest, 0.1)
        stroke = min(0.98 * room, speed * (ramp + longest))
        if stroke < 1.2 * speed * ramp:
            raise ExcitationError(
                f"{robot.joints[j]} has {room:.3g} rad of room about the posture, and "
                f"{1.2 * speed * ramp:.3g} rad are needed to reach {speed:g} rad/s"
            )
        for sign in (1.0, -1.0):
            start = home.copy()
            start[j] -= sign * stroke / 2
            knots.move(start, bounds)
            knots.wait(_PAUSE)
            knots.cruise(j, sign * speed, ramp, stroke / speed - ramp)
            knots.wait(_PAUSE)
    knots.move(home, bounds)
    return checked(robot, knots.reference(rate), bounds)


def micro_reversals(
    robot: Robot,
    joint: str | int,
    *,
    amplitudes: Sequence[float] = (0.001, 0.002, 0.005, 0.01, 0.02),
    repeats: int = 3,
    period: float = 2.0,
    posture: Array | None = None,
    rate: float = 500.0,
    limits: Limits | None = None,
) -> Reference:
    """One joint forth and back by small angles, from small to large.

    Args:
        robot: The arm.
        joint: Joint that moves.
        amplitudes: Half strokes, [rad].
        repeats: Full cycles at each.
        period: Time of one cycle, [s].
        posture: Where all joints begin, shape (n,), [rad]; by default the middle.
        rate: Samples per second, [Hz].
        limits: Limits to keep; 80 % of the robot file's by default.
    """
    bounds, home, j = _settings(robot, joint, limits, posture)
    if repeats < 1 or not period > 0:
        raise ExcitationError("repeats from 1 and a period above 0 s are valid")
    knots = Walk(home)
    for amplitude in amplitudes:
        for sign in (*(1.0, -1.0) * repeats, 0.0):
            goal = home.copy()
            goal[j] += sign * float(amplitude)
            knots.go(goal, period / 2)
        knots.wait(_PAUSE)
    return checked(robot, knots.reference(rate), bounds)


def static_poses(
    robot: Robot,
    poses: Array,
    *,
    hold: float = 1.0,
    rate: float = 500.0,
    limits: Limits | None = None,
) -> Reference:
    """From pose to pose, at rest in each.

    Args:
        robot: The arm.
        poses: Poses to visit in this order, shape (K, n), [rad].
        hold: Time at rest in each, [s].
        rate: Samples per second, [Hz].
        limits: Limits to keep; 80 % of the robot file's by default.
    """
    bounds = Limits.of(robot) if limits is None else limits
    goals = np.atleast_2d(np.asarray(poses, dtype=float))
    if goals.shape[1] != robot.size or not hold > 0:
        raise ExcitationError(
            f"poses of {robot.size} joints and a hold above 0 s are valid"
        )
    knots = Walk(goals[0])
    for goal in goals:
        knots.move(goal, bounds)
        knots.wait(hold)
    return checked(robot, knots.reference(rate), bounds)


def multisine(
    robot: Robot,
    *,
    lowest: float = 0.2,
    highest: float = 5.0,
    duration: float = 20.0,
    fill: float = 0.5,
    posture: Array | None = None,
    seed: int | np.random.Generator = 0,
    rate: float = 500.0,
    limits: Limits | None = None,
) -> Reference:
    """All joints at once, with power at many frequencies and random phases.

    Joints have no frequency in common, so that what each one does can be told apart
    (Pintelon and Schoukens 2012, doi 10.1002/9781118287422, chapter 2). Amplitudes fall
    with frequency, so that each tone accelerates alike; both ends are at rest.

    Args:
        robot: The arm.
        lowest: Lowest frequency, [Hz].
        highest: Highest frequency, [Hz].
        duration: Length, [s].
        fill: Part of the limits to use.
        posture: Middle of the motion, shape (n,), [rad]; by default of the range.
        seed: Seed or generator of the phases.
        rate: Samples per second, [Hz].
        limits: Limits to keep; 80 % of the robot file's by default.
    """
    bounds, home, _ = _settings(robot, 1, limits, posture)
    lines = np.arange(np.ceil(lowest * duration), np.floor(highest * duration) + 1)
    if len(lines) < robot.size or lines[0] < 1 or 2 * highest >= rate:
        raise ExcitationError(
            f"{len(lines)} tones from {lowest:g} to {highest:g} Hz in {duration:g} s; "
            "valid is one tone or more for each joint, above 0 and below half the rate "
            f"{rate:g} Hz"
        )
    rng, t = np.random.default_rng(seed), uniform(duration, rate)
    fade = min(1.0, duration / 4)
    window = _window(t, duration, fade)
    sizes = [fill * x for x in (bounds.speed, bounds.usable_acceleration)]
    q, v, a = np.zeros((3, len(t), robot.size))
    for j in range(robot.size):
        w = 2 * np.pi * lines[j :: robot.size] / duration
        phase = rng.uniform(0, 2 * np.pi, len(w))
        tones = [
            np.sin(np.outer(t, w) + phase + k * np.pi / 2) @ w ** (k - 2.0)
            for k in range(3)
        ]
        x = _product(window, tones)
        room = fill * min(home[j] - bounds.low[j], bounds.high[j] - home[j])
        peaks = np.abs(x).max(axis=1) / (room, sizes[0][j], sizes[1][j])
        q[:, j], v[:, j], a[:, j] = x / peaks.max()
    return checked(robot, _within_torque(robot, home, (q, v, a), t, bounds), bounds)


def checked(
    robot: Robot, reference: Reference, limits: Limits | None = None
) -> Reference:
    """Check a reference against the limits, and return it.

    Args:
        robot: The arm.
        reference: Motion to check.
        limits: Limits; those of the robot file by default.

    Raises:
        ExcitationError: It does not; the message says which limit of which joint.
    """
    bounds = Limits.of(robot, fill=1.0) if limits is None else limits
    bounds = replace(bounds, jerk=np.full(robot.size, np.inf))
    path = path_from_reference(reference)
    for constraint in (
        MotionLimits(bounds, robot.joints),
        TorqueLimits(robot, bounds.torque),
    ):
        worst = constraint.excess(path).max(axis=0, initial=-1.0)
        if (worst > 1e-9).any():
            k = int(worst.argmax())
            raise ExcitationError(
                f"the {constraint.names[k]} is exceeded by {100 * worst[k]:.2g} %; "
                "valid is a slower or smaller motion"
            )
    return reference


def path_from_reference(reference: Reference) -> Path:
    """Samples of a reference; its jerk is not known and taken as zero."""
    zero = np.zeros_like(reference.q)
    return Path(reference.t, reference.q, reference.v, reference.a, zero)


def _settings(
    robot: Robot, joint: str | int, limits: Limits | None, posture: Array | None
) -> tuple[Limits, Array, int]:
    bounds = Limits.of(robot) if limits is None else limits
    middle = (bounds.low + bounds.high) / 2
    home = middle if posture is None else np.asarray(posture, dtype=float)
    if home.shape != (robot.size,):
        raise ExcitationError(f"a posture needs {robot.size} values")
    if (home < bounds.low).any() or (home > bounds.high).any():
        raise ExcitationError("the posture lies outside the position limits")
    return bounds, home.copy(), robot.joint_index(joint)


def _window(t: Array, duration: float, fade: float) -> Array:
    """Rises from 0 to 1 and falls again, with two derivatives, shape (3, N)."""
    knots = np.array([0.0, fade, duration - fade, duration])
    levels = np.array([0.0, 1.0, 1.0, 0.0])
    states = np.stack([levels, np.zeros(4), np.zeros(4)], axis=1)
    curve = BPoly.from_derivatives(knots, states)
    return np.stack([np.asarray(curve(t, nu=k)) for k in range(3)])


def _product(x: Array, y: Sequence[Array]) -> Array:
    """A product and its two derivatives, shape (3, N)."""
    return np.stack(
        [
            x[0] * y[0],
            x[1] * y[0] + x[0] * y[1],
            x[2] * y[0] + 2 * x[1] * y[1] + x[0] * y[2],
        ]
    )


def _within_torque(
    robot: Robot,
    home: Array,
    motion: tuple[Array, Array, Array],
    t: Array,
    limits: Limits,
) -> Reference:
    """The motion about a posture, made smaller until the torque allows it."""
    constraint = TorqueLimits(robot, limits.torque)
    for factor in 0.85 ** np.arange(25):
        q, v, a = (factor * x for x in motion)
        reference = Reference(t, home + q, v, a)
        if constraint.excess(path_from_reference(reference)).max(initial=-1.0) <= 0:
            return reference
    raise ExcitationError(
        "gravity alone takes more torque than allowed at this posture"
    )
