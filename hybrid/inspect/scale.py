"""Infer the unit of torque from the weight of the robot file's links.

Each torque is a sum of the file's, times a scale, and of friction, rotor and offset.
Files are wrong by a factor of two or so, payloads add to it; units by ten or more.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.regressor import inverse_dynamics
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.inspect.masses import direction
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot

_TELLS = 0.25  # of the variance that friction leaves: less, and the scale is no scale
_ODD, _WRONG = 3.0, 10.0  # factors: beyond what files and tools do; beyond doubt
_UNITS = {1e-3: "kN·m", 1e3: "mN·m"}
_UNIT = 3.0  # factor by which a scale may miss a unit
_FARTHEST = 5.0  # times the rating: gear or unit missing, not overload
_GEARS = 500.0  # a higher ratio of a gear is rare
_CONSTANTS = 30.0  # N·m/A at the joint: more is a rare drive
_VALID = "valid are N·m at the joint"


def scales(robot: Robot, state: State) -> Array:
    """Measured torque over that of the file's links, shape (n,); NaN if not told."""
    file = inverse_dynamics(
        robot.chain, robot.chain.inertial, state.q, state.v, state.a
    ) + robot.joint_torque(state.q, np.zeros_like(state.v), state.a)
    found, dry = np.full(robot.size, np.nan), direction(state.v)
    for j in range(robot.size):
        v, a = state.v[:, j], state.a[:, j]
        beside = [np.ones_like(v), v, dry[:, j]]
        if not robot.chain.armature[j]:
            beside.append(a)
        basis = np.linalg.qr(np.stack(beside, axis=1))[0]
        x, y = (z - basis @ (basis.T @ z) for z in (file[:, j], state.tau[:, j]))
        if x @ x > 1e-6 * (file[:, j] @ file[:, j]) and y @ y > 0:
            tells = (x @ y) ** 2 / (x @ x) / (y @ y)
            found[j] = x @ y / (x @ x) if tells > _TELLS else np.nan
    return found


def doubts_of_scale(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Torques in another unit, or of the motor side."""
    if robot is None or not recording.has_torque:
        return
    each = scales(robot, state)
    told = int(np.sum(each > 0))
    if not told:
        yield from _above_rating(recording, robot)
        return
    less, more = (each > 0) & (each < 1 / _ODD), each > _ODD
    # A unit is of all joints. A tool adds a lot to what a wrist holds, and may make up
    # there for one that is too small; a counterbalance takes from one joint alone.
    if more.sum() == told or (2 * less.sum() > told and less.sum() >= min(told, 2)):
        usual = float(np.median(each[less if less.any() else more]))
        # Without gravity inertia alone tells, and it goes with the square of time.
        remedy = (
            f"{_VALID}: check the unit of torque, the clock, and the masses of the "
            f"file{_constants(each)}"
        )
        severity = error_if(max(usual, 1 / usual) > _WRONG and told > 1)
        yield Doubt("tau", (), _text("tau", usual), remedy, severity, usual)
        return
    # A tool adds a lot to what a wrist holds; nothing takes so much away.
    for j in np.flatnonzero((each > 0) & (each < 1 / _WRONG)).tolist():
        text = _text(recording.place("tau", j), each[j])
        yield Doubt("tau", (j,), text, _VALID, "error", each[j])


def _above_rating(recording: Recording, robot: Robot) -> Iterator[Doubt]:
    """Torques far above the rating, where the file's links tell no scale."""
    peak = np.max(np.abs(recording.tau), axis=0)
    rated = np.where(robot.tau_max > 0, robot.tau_max, np.inf)
    far = np.flatnonzero(peak > _FARTHEST * rated).tolist()
    if far:
        places = ", ".join(
            f"{recording.place('tau', k)} {peak[k]:.4g} of {rated[k]:.4g}" for k in far
        )
        text = (
            f"torque above {_FARTHEST:g} times the rating ({places}): in milliamps? or "
            "is the rating that of the motor side"
        )
        yield Doubt("tau", tuple(far), text, _VALID, evidence=float(max(peak / rated)))


def _text(what: str, scale: float) -> str:
    """What a scale looks like, in words."""
    looks = [x for unit, x in _UNITS.items() if 1 / _UNIT < scale / unit < _UNIT]
    if not looks:
        if 1 / _CONSTANTS < scale < 1 / _ODD:
            looks.append("a motor current in A, which UR's ROS driver calls effort")
        if 1 / _GEARS < scale < 1 / _WRONG:
            looks.append(f"torque of the motor side of a gear 1:{1 / scale:.0f}")
    text = f"{what} is {scale:.3g} times what the robot file's links ask for"
    return f"{text}: it looks like {', or '.join(looks)}" if looks else text


def _constants(each: Array) -> str:
    """What to type if torques are currents, by the file's links."""
    if not 1 / _CONSTANTS < np.nanmedian(each) < 1 / _ODD:
        return ""
    told = ", ".join(f"{1 / x:.3g}" if x > 0 else "?" for x in each)
    return (
        "; a current takes --map FILE.yaml with tau: {unit: A, torque_constant: ...}: "
        f"the file's links ask for {told} N·m/A at the joints"
    )
