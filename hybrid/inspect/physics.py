"""Test order, signs, angle unit and clock of a log by rigid-body dynamics.

Of all ways to read a log the right one leaves least torque that no arm of real masses
explains. With s the share of its variance that is left of each joint's torque, a
reading is better than the plain one by

    gain = ½ Σ log(s_plain / s_read),

the logarithm of how much smaller the volume of what is left becomes. Two designs are
asked: masses anywhere (what no arm does, no robot file excuses), and those of the file
in any measure, which tells more but may itself be wrong: what only they tell is a
warning. The sign of torques that were logged without it is asked before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.regressor import inverse_dynamics, regressor
from hybrid.inspect.doubt import Doubt, Severity
from hybrid.inspect.masses import SURE, MassColumns, unit_masses
from hybrid.inspect.reading import OtherReading, readings
from hybrid.inspect.samples import STILL
from hybrid.inspect.speeds import bear_out
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

_ALIKE = 0.2  # loss of gain by which two readings may differ and be as good
_USUAL = 0.003  # of the variance: what friction of another law leaves anyway
_SEVERITIES: dict[str, Severity] = {"any": "error", "file": "warning"}
_FINALISTS = 6  # readings that are asked with joints weighed anew
_DISTURBS = 0.02  # of what one joint leaves, in what others do: they share their links
_MOST = 4  # things that are wrong with one log
_TOUCHES = 0.1  # of the largest torque: one that never comes near zero has one sign
_DRY = 0.3  # of the mean torque
_TURNS = 8  # rounds in which signs and torques are found from each other


class _Bench:
    """One log by any reading, under designs of masses, of shape (n, 10, P) each."""

    def __init__(self, chain: Chain, state: State, masses: dict[str, Array]) -> None:
        self.chain, self.state, self.masses = chain, state, masses
        self._regressors: dict[object, Array] = {}
        self._columns: dict[object, MassColumns] = {}

    def prepare(self, ways: Sequence[OtherReading]) -> None:
        """Work out the regressors of some readings, all at once."""
        moved = {way.motion: way.moved(self.state) for way in ways}
        q, v, a = (
            np.concatenate([getattr(s, x) for s in moved.values()]) for x in "qva"
        )
        Y = np.split(regressor(self.chain, q, v, a), len(moved))
        self._regressors |= zip(moved, Y, strict=True)

    def columns(self, reading: OtherReading, design: str) -> MassColumns:
        """Columns along the motion of a reading."""
        key = design, reading.motion
        if key not in self._columns:
            moved, Y = reading.moved(self.state), self._regressors[reading.motion]
            self._columns[key] = MassColumns(moved, self.masses[design], Y)
        return self._columns[key]

    def left(self, reading: OtherReading, design: str, rounds: int = 2) -> Array:
        """Shares of torque that a reading leaves, shape (n,)."""
        columns = self.columns(reading, design)
        left = columns.left(*reading.torque, rounds=rounds)
        # So little, a file that is right leaves as well.
        return np.maximum(left, _USUAL) if design == "file" else left


def doubts_of_magnitude(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Torques without their sign: the magnitude of a current, as some drives log it.

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


def doubts_of_physics(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """What of order, sign, unit and clock is wrong with a log, the surest first."""
    if robot is None or not recording.has_torque:
        return
    masses = {"any": unit_masses(robot.chain)}
    clocked = bear_out(state)
    if robot.chain.inertial.any():
        masses["file"] = robot.chain.inertial[:, :, None]
    for _ in range(_MOST):
        found = _likelier(_Bench(robot.chain, state, masses), clocked)
        if found is None:
            return
        reading, before, after, severity = found
        yield _doubt(recording, reading, before, after, severity)
        state = reading.of(state)


def _likelier(
    bench: _Bench, clocked: bool
) -> tuple[OtherReading, Array, Array, Severity] | None:
    """The reading that is better than the plain one, if any is by far.

    Returns:
        It, the shares left before and after, and how serious it is.
    """
    from scipy.optimize import linear_sum_assignment

    n = bench.chain.size
    plain = OtherReading((), (), "", np.arange(n), np.ones(n))
    bench.prepare([plain])
    before = {design: bench.left(plain, design) for design in bench.masses}
    hopeful = [d for d, x in before.items() if _gain(x, np.minimum(x, _USUAL)) > SURE]
    if not hopeful:
        return None
    moving = np.flatnonzero(np.ptp(bench.state.q, axis=0) > STILL).tolist()
    alone = np.log(bench.columns(plain, "any").left_alone())
    ways = list(readings(bench.chain, moving, linear_sum_assignment(alone)[1]))
    if clocked:
        ways = [way for way in ways if way.channels != ("t",)]
    bench.prepare(ways)
    for design in bench.masses:
        roughly = bench.left(plain, design, 1)
        gains = [_gain(roughly, bench.left(way, design, 1)) for way in ways]
        finalists = [ways[k] for k in np.argsort(gains)[: -_FINALISTS - 1 : -1]]
        after = [bench.left(way, design) for way in finalists]
        found = [_gain(before[design], x) for x in after]
        best = int(np.argmax(found))
        if found[best] > SURE:
            return finalists[best], before[design], after[best], _SEVERITIES[design]
        # What no arm can do is not asked of the file.
        ways = [w for w, gain in zip(ways, gains, strict=True) if gain > -_ALIKE]
        if not ways or "file" not in hopeful:
            break
    return None


def _gain(before: Array, after: Array) -> float:
    least = _DISTURBS * float(before.mean())
    ratio = np.maximum(before, least) / np.maximum(after, least)
    return float(0.5 * np.log(ratio).sum())


def _doubt(
    recording: Recording,
    reading: OtherReading,
    before: Array,
    after: Array,
    severity: Severity,
) -> Doubt:
    """A reading in words, with what it leaves at the joint where it tells most."""
    places = [
        " and ".join(recording.place(channel, j) for channel in reading.channels)
        for j in reading.joints
    ]
    if reading.channels == ("t",):
        what = f"time looks {reading.looks_like}"
    elif len(places) > 2 and len(places) == recording.size:
        what = f"{' and '.join(reading.channels)} look {reading.looks_like}"
    else:
        verb = "looks" if len(places) * len(reading.channels) == 1 else "look"
        what = f"{' and '.join(places)} {verb} {reading.looks_like}"
    j = int(np.argmax(before / after))
    whose = "an arm of real masses" if severity == "error" else "the file's links"
    gain = float(np.exp(_gain(before, after)))
    text = (
        f"{what}: read so, {whose} leave{'s' * (severity == 'error')} "
        f"{after[j]:.2g} of the variance of {recording.place('tau', j)} unexplained, "
        f"as logged {before[j]:.2g}"
    )
    remedy = "valid are rad, N·m and s, by the robot file's axes, in its order"
    return Doubt(reading.channels[0], reading.joints, text, remedy, severity, gain)
