"""Torque without its sign: the magnitude of a current, as some drives log it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hybrid.dynamics.regressor import inverse_dynamics, regressor
from hybrid.inspect.doubt import Doubt
from hybrid.inspect.masses import SURE, MassColumns, unit_masses
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot

_TOUCHES = 0.1  # of the largest torque: one that never comes near zero has one sign
_DRY = 0.3  # of the mean torque
_TURNS = 8  # rounds in which signs and torques are found from each other


def doubts_of_magnitude(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Detect torques whose sign was not logged.

    Signs are those of the torque that the arm explains, which is found with them. At
    first that is the torque of the file's links and of some dry friction.
    """
    tau = recording.tau
    touches = np.abs(tau).min(axis=0) < _TOUCHES * np.abs(tau).max(axis=0)
    suspect = (tau.min(axis=0) >= 0) & touches  # never where tau is NaN
    if robot is None or not suspect.any():
        return
    chain, (q, v, a) = robot.chain, (state.q, state.v, state.a)
    masses, Y = unit_masses(chain), regressor(chain, q, v, a)
    plain = np.arange(chain.size), np.ones(chain.size)
    before = after = MassColumns(state, masses, Y).left(*plain)
    fastest = np.maximum(np.abs(v).max(axis=0), 1e-12)
    dry = _DRY * state.tau.mean(axis=0) * np.tanh(v / (0.1 * fastest))
    likely = inverse_dynamics(chain, chain.inertial, q, v, a) + dry
    for _ in range(_TURNS):
        sign = np.where(suspect & (likely < 0), -1.0, 1.0)
        columns = MassColumns(replace(state, tau=sign * state.tau), masses, Y)
        after, likely = columns.left(*plain), columns.explained
    gain = 0.5 * np.log(before / after)
    for j in np.flatnonzero(suspect & (gain > SURE)).tolist():
        text = (
            f"{recording.place('tau', j)} looks like the magnitude of a torque: with "
            f"signs, masses leave {after[j]:.2g} of its variance, as logged "
            f"{before[j]:.2g}"
        )
        remedy = "valid is a torque with its sign"
        yield Doubt("tau", (j,), text, remedy, "error", float(np.exp(gain[j])))
