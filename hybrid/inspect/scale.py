"""Infer the unit of torque from the links in the robot file.

Each measured torque is fitted by the torque of the file's links, times a scale, plus
friction, rotor inertia and an offset. Files are wrong by a factor of about two, and a
payload adds to that; a wrong unit is a factor of ten or more.
"""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.dynamics.regressor import inverse_dynamics
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.inspect.masses import smooth_sign
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot

_EXPLAINED = 0.25  # least share of the variance that determines a scale
_ODD, _WRONG = 3.0, 10.0  # factors: more than files and payloads explain; an error
_UNITS = {1e-3: "kN·m", 1e3: "mN·m"}
_LARGEST_GEAR = 500.0  # ratio
_LARGEST_CONSTANT = 30.0  # N·m/A at the joint
_VALID = "valid are N·m at the joint"


def scales(robot: Robot, state: State) -> Array:
    """Scale of measured torque to the file's, shape (n,); NaN if not determined."""
    file = inverse_dynamics(
        robot.chain, robot.chain.inertial, state.q, state.v, state.a
    ) + robot.joint_torque(state.q, np.zeros_like(state.v), state.a)
    found, dry = np.full(robot.size, np.nan), smooth_sign(state.v)
    for j in range(robot.size):
        v, a = state.v[:, j], state.a[:, j]
        drive = [np.ones_like(v), v, dry[:, j]]
        if not robot.chain.armature[j]:
            drive.append(a)
        basis = np.linalg.qr(np.stack(drive, axis=1))[0]
        x, y = (z - basis @ (basis.T @ z) for z in (file[:, j], state.tau[:, j]))
        if x @ x > 1e-6 * (file[:, j] @ file[:, j]) and y @ y > 0:
            explained = (x @ y) ** 2 / (x @ x) / (y @ y)
            found[j] = x @ y / (x @ x) if explained > _EXPLAINED else np.nan
    return found


def doubts_of_scale(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Find torques in another unit, or of the motor side."""
    if robot is None or not recording.has_torque:
        return
    each = scales(robot, state)
    known = int(np.sum(each > 0))
    less, more = (each > 0) & (each < 1 / _ODD), each > _ODD
    # All joints share a unit. A tool adds much load at the wrist, which may hide a unit
    # that is too small; a counterbalance takes load from one joint only.
    if more.sum() == known > 0 or (
        2 * less.sum() > known and less.sum() >= min(known, 2)
    ):
        usual = float(np.median(each[less if less.any() else more]))
        # Without gravity only inertia is compared, which depends on the clock squared.
        remedy = (
            f"{_VALID}: check the unit of torque, the clock, and the masses of the "
            f"file{_constants(each)}"
        )
        severity = error_if(max(usual, 1 / usual) > _WRONG and known > 1)
        yield Doubt("tau", (), _text("tau", usual), remedy, severity, usual)
        return
    # A tool may add much load at one joint; nothing removes so much.
    for j in np.flatnonzero((each > 0) & (each < 1 / _WRONG)).tolist():
        text = _text(recording.place("tau", j), each[j])
        yield Doubt("tau", (j,), text, _VALID, "error", each[j])
    right = (each > 1 / _ODD) & (each < _ODD)
    yield from _above_rating(recording, robot, ~right)


def _above_rating(recording: Recording, robot: Robot, open_: Mask) -> Iterator[Doubt]:
    """Find torques far above the rating where the links do not tell the scale."""
    peak = np.max(np.abs(recording.tau), axis=0)
    rated = np.where(robot.tau_max > 0, robot.tau_max, np.inf)
    far = np.flatnonzero(open_ & (peak > _WRONG * rated)).tolist()
    if far:
        places = ", ".join(
            f"{recording.place('tau', k)} {peak[k]:.4g} of {rated[k]:.4g}" for k in far
        )
        text = (
            f"torque above {_WRONG:g} times the rating ({places}): in milliamps? or "
            "is the rating that of the motor side"
        )
        yield Doubt("tau", tuple(far), text, _VALID, evidence=float(max(peak / rated)))


def _text(what: str, scale: float) -> str:
    """Describe a scale, with the unit that it suggests."""
    looks = [x for unit, x in _UNITS.items() if 1 / _ODD < scale / unit < _ODD]
    if not looks:
        if 1 / _LARGEST_CONSTANT < scale < 1 / _ODD:
            looks.append("a motor current in A, which UR's ROS driver calls effort")
        if 1 / _LARGEST_GEAR < scale < 1 / _WRONG:
            looks.append(f"torque of the motor side of a gear 1:{1 / scale:.0f}")
    text = f"{what} is {scale:.3g} times what the robot file's links ask for"
    return f"{text}: it looks like {', or '.join(looks)}" if looks else text


def _constants(each: Array) -> str:
    """Say which option to use if the torques are motor currents."""
    if not 1 / _LARGEST_CONSTANT < np.nanmedian(each) < 1 / _ODD:
        return ""
    constants = ", ".join(f"{1 / x:.3g}" if x > 0 else "?" for x in each)
    return (
        "; a current takes --map FILE.yaml with tau: {unit: A, torque_constant: ...}: "
        f"the file's links ask for {constants} N·m/A at the joints"
    )
