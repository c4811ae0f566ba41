"""Torque without its sign: the magnitude of a current, as some drives log it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.regressor import inverse_dynamics, regressor
from hybrid.inspect.doubt import Doubt
from hybrid.inspect.masses import MassColumns, unit_masses
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot.chain import Chain

_TOUCHES = 0.1  # of the largest torque: one that never comes near zero has one sign
_SURE = 0.5  # half the logarithm of the share that signs take off what is left
_DRY = 0.3  # of the mean torque
_TURNS = 8  # rounds in which signs and torques are found from each other


def doubts_of_magnitude(
    recording: Recording, chain: Chain, state: State
) -> Iterator[Doubt]:
    """Detect torques whose sign was not logged.

    Signs are those of the torque that the arm explains, which is found with them.

    Args:
        recording: The log, for names.
        chain: The arm.
        state: Samples of the log.
    """
    tau = recording.tau
    least, most = np.abs(tau).min(axis=0), np.abs(tau).max(axis=0)
    suspect = (tau.min(axis=0) >= 0) & (least < _TOUCHES * most)
    if not suspect.any():
        return
    masses, n = unit_masses(chain), chain.size
    plain = np.arange(n), np.ones(n)
    Y = regressor(chain, state.q, state.v, state.a)
    before = after = MassColumns(state, masses, Y).left(*plain)
    likely = _likely_torque(chain, state)
    for _ in range(_TURNS):
        sign = np.where(suspect & (likely < 0), -1.0, 1.0)
        columns = MassColumns(replace(state, tau=sign * state.tau), masses, Y)
        after, likely = columns.left(*plain), columns.explained
    gain = 0.5 * np.log(before / after)
    for j in np.flatnonzero(suspect & (gain > _SURE)).tolist():
        text = (
            f"{recording.place('tau', j)} looks like the magnitude of a torque: with "
            f"signs, masses leave {after[j]:.2g} of its variance, as logged "
            f"{before[j]:.2g}"
        )
        remedy = "valid is a torque with its sign"
        yield Doubt("tau", (j,), text, remedy, "error", float(np.exp(gain[j])))


def _likely_torque(chain: Chain, state: State) -> Array:
    """Torque of the file's links and of some dry friction, shape (M, n), [N·m]."""
    file = inverse_dynamics(chain, chain.inertial, state.q, state.v, state.a)
    fastest = np.maximum(np.abs(state.v).max(axis=0), 1e-12)
    dry = np.tanh(state.v / (0.1 * fastest))
    return np.asarray(file + _DRY * state.tau.mean(axis=0) * dry)
