"""A first guess of the servo parameters by linear least squares, without replays.

At every sample the servo balances weight, friction and inertia,

    k (c − q) = g(q) + b q̇ + F_c sgn q̇ + J q̈ + const,

which is linear in (1, b, F_c, J, const)/k, with gravity g by the masses of the file. A
delay of the command looks like damping here.
"""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.regressor import inverse_dynamics
from hybrid.robot import Robot
from hybrid.servo.drive import Drive
from hybrid.servo.simulator import ServoSimulator, missed
from hybrid.servo.stretch import Stretch
from hybrid.signals.filters import butterworth, central_difference

_BAND = 4.0  # Hz: cut-off for accelerations from a coarse encoder
_CREEP = 0.02  # rad/s: smooths the step of Coulomb friction at zero speed
_DELAYS = tuple(0.02 * k for k in range(6))  # s: candidates
_STIFFER = (1.0, 2.0, 4.0)  # factors of the guess: friction looks like softness
_LOADED = 0.1  # of the largest change of weight: below, stiffness is unknown
_LEAST = 1e-3  # rad, s or s², times stiffness: least friction, damping, rotor


def first_guess(robot: Robot, stretches: Sequence[Stretch], declared: Drive) -> Drive:
    """Guess the servos from which a fit by replay starts."""
    inertial = robot.chain.inertial * declared["mass"][:, None]
    parts = [_signals(robot, inertial, x) for x in stretches]
    q, v, a, weight = (np.concatenate([p[k] for p in parts]) for k in range(4))
    error = np.concatenate([x.command for x in stretches]) - q
    slope, found = np.full(robot.size, np.nan), []
    for j in range(robot.size):
        columns = [weight[:, j], v[:, j], np.tanh(v[:, j] / _CREEP), a[:, j]]
        basis = np.stack([*columns, np.ones(len(v))], axis=1)
        found.append(np.linalg.lstsq(basis, error[:, j], rcond=None)[0])
        if np.ptp(weight[:, j]) > _LOADED * np.abs(weight).max():
            slope[j] = found[j][0]
    # Joints that carry no weight get the stiffness of those that do.
    told = slope[slope > 0]
    usual = 1.0 / np.median(told) if len(told) else np.median(declared["stiffness"])
    theta, least = np.array(found).T * usual, _LEAST * usual
    return declared.at(
        stiffness=usual,
        damping=np.maximum(theta[1], least),
        coulomb=np.maximum(theta[2], least),
        armature=np.maximum(theta[3], least),
        offset=-theta[4],
    )


def best_start(
    simulator: ServoSimulator, stretches: Sequence[Stretch], guess: Drive, file: Drive
) -> Drive:
    """Choose for each joint the servo and the delay that replay best.

    Candidates are the guess and the file. In slow motion a delay d looks like damping
    k·d, which is taken off the guessed damping.
    """
    stiffness, tried = guess["stiffness"], [file]
    for delay in _DELAYS:
        tried.append(file.at(delay=delay))
        rest = np.maximum(guess["damping"] - stiffness * delay, _LEAST * stiffness)
        late = guess.at(delay=delay, damping=rest)
        tried += [late.at(stiffness=stiffness * times) for times in _STIFFER]
    best = missed(simulator, stretches, tried).argmin(axis=0)
    values = [tried[k].values[:, j] for j, k in enumerate(best.tolist())]
    return Drive(np.stack(values, axis=1), guess.stall)


def _signals(robot: Robot, inertial: Array, stretch: Stretch) -> Sequence[Array]:
    """Position, speed, acceleration and weight of a stretch, (N, n) each."""
    rate = 1.0 / stretch.step
    q = butterworth(stretch.q, rate=rate, cutoff=min(_BAND, 0.4 * rate))
    v = central_difference(q, rate=rate)
    rest = np.zeros_like(q)
    weight = inverse_dynamics(robot.chain, inertial, q, rest, rest)
    return q, v, central_difference(v, rate=rate), weight
