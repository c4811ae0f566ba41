"""Test order, signs, units, zeros and clock of a log by rigid-body dynamics.

Of all readings of a log the right one leaves the smallest residual of a fit with masses
that may exist. With s the share of each torque's variance in the residual, a reading is
better than the log as written by

    gain = ½ Σ log(s_written / s_read),

the decrease of the logarithmic volume of the residual. There are two fits. A fault that
masses anywhere on the links reveal is an error. A fault that only the links of the
robot file reveal, each times a scale, is a warning, as the file may be wrong; so is one
that samples which a fit does not see tell less clearly.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.regressor import inverse_dynamics, regressor
from hybrid.inspect.doubt import Doubt, Severity, error_if
from hybrid.inspect.masses import MassColumns, smooth_sign, unit_masses
from hybrid.inspect.reading import OtherReading, readings
from hybrid.inspect.samples import STILL
from hybrid.inspect.speeds import speeds_confirm_clock
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import choose_cutoff, motion_from_recording
from hybrid.signals.bandwidth import FILTERED, torque_bandwidth

_LEAST_GAIN = 0.5  # no other reading of a right log reached 0.3
_SPLITS = 2, 4, 8  # blocks, of which every other one is not seen
_EQUAL_GAIN = 0.2  # difference of gain between readings that are equally good
_FRICTION_ERROR = 0.003  # share of the variance that another friction law leaves
_SCALE_ERROR = 0.03  # the same of a law that a scale of torque may imitate
_VALID = "valid are rad, N·m and s, by the robot file's axes and zeros, in its order"
_WHOSE = {"any": "an arm of real masses leaves", "file": "the file's links leave"}
_FINALISTS = 6  # readings that are fitted with weighted joints
_SHARED = 0.02  # of the mean residual share: least at a joint, as joints share links
_MOST_FAULTS = 4  # of one log
_NEAR_ZERO = 0.1  # of the largest torque: a torque that is always larger has one sign
_DRY = 0.3  # of the mean torque
_SIGN_ROUNDS = 8  # alternating estimates of signs and torques
_SAMPLES = 12.0  # in a period of the cut-off
_RANK = 1e-6  # smallest singular value, over the largest


class _Readings:
    """Residuals of a log by any reading, for each set of masses, shape (n, 10, P)."""

    def __init__(self, robot: Robot, state: State, masses: dict[str, Array]) -> None:
        self.robot, self.state, self.masses = robot, state, masses
        each = np.arange(robot.size)
        self.written = OtherReading((), (), "", each, np.ones(len(each)))
        self._columns: dict[object, MassColumns] = {}
        self._moved: dict[object, tuple[State, Array]] = {}

    def columns(self, reading: OtherReading, masses: str) -> MassColumns:
        """Columns along the motion of a reading."""
        key = masses, reading.motion
        if key not in self._columns:
            self._move([reading])
            moved, Y = self._moved[reading.motion]
            own = self.masses[masses]
            self._columns[key] = MassColumns(self.robot, moved, own, Y)
        return self._columns[key]

    def _move(self, others: Sequence[OtherReading]) -> None:
        """Make the regressors along the motions of some readings, all at once."""
        new = {x.motion: x for x in others if x.motion not in self._moved}
        moved = [x.moved(self.state) for x in new.values()]
        if moved:
            motion = (np.concatenate([getattr(x, k) for x in moved]) for k in "qva")
            Y = np.split(regressor(self.robot.chain, *motion), len(moved))
            self._moved |= zip(new, zip(moved, Y, strict=True), strict=True)

    def residual(self, reading: OtherReading, masses: str, **how: int) -> Array:
        """:meth:`MassColumns.residual` of a reading, shape (n,)."""
        order, factor = reading.torque
        left = self.columns(reading, masses).residual(order, factor, **how)
        return np.maximum(left, _FRICTION_ERROR) if masses == "file" else left

    def gains(self, others: list[OtherReading], masses: str, **how: int) -> list[float]:
        """Gain of other readings over the log as written."""
        self._move(others)
        before = self.residual(self.written, masses, **how)
        return [_gain(before, self.residual(x, masses, **how), x) for x in others]


def doubts_of_magnitude(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Find torques without a sign: the magnitude of a current, as some drives log it.

    Signs and fitted torque are estimated in turn. The first estimate is the torque of
    the file's links plus some dry friction.
    """
    tau = recording.tau
    near_zero = np.abs(tau).min(axis=0) < _NEAR_ZERO * np.abs(tau).max(axis=0)
    suspect = (tau.min(axis=0) >= 0) & near_zero  # False where tau is NaN
    if robot is None or not suspect.any():
        return
    chain, motion = robot.chain, (state.q, state.v, state.a)
    masses, Y = unit_masses(chain), regressor(chain, *motion)
    plain = np.arange(chain.size), np.ones(chain.size)
    before = after = MassColumns(robot, state, masses, Y).residual(*plain)
    likely = inverse_dynamics(chain, chain.inertial, *motion)
    likely += _DRY * state.tau.mean(axis=0) * smooth_sign(state.v)
    for _ in range(_SIGN_ROUNDS):
        sign = np.where(suspect & (likely < 0), -1.0, 1.0)
        signed = replace(state, tau=sign * state.tau)
        columns = MassColumns(robot, signed, masses, Y)
        after, likely = columns.residual(*plain), columns.explained
    # Signs change the variance, too, to which the shares refer.
    variance = [x.tau[:, suspect].var(axis=0) for x in (signed, state)]
    after[suspect] *= variance[0] / variance[1]
    gain = 0.5 * np.log(before / after)
    for j in np.flatnonzero(suspect & (gain > _LEAST_GAIN)).tolist():
        text = (
            f"{recording.place('tau', j)} looks like the magnitude of a torque: with "
            f"signs, masses leave {after[j]:.2g} of its variance, as logged "
            f"{before[j]:.2g}"
        )
        remedy = "valid is a torque with its sign"
        yield Doubt("tau", (j,), text, remedy, "error", float(np.exp(gain[j])))


def doubts_of_filter(recording: Recording, robot: Robot) -> Iterator[Doubt]:
    """Find torque that was low-pass filtered before it was logged.

    It has less power at high frequencies than a fit of links, rotors and friction.
    """
    cutoff = choose_cutoff(recording)
    motion = motion_from_recording(recording, cutoff=cutoff)
    few = slice(None, None, max(1, int(motion.rate / (_SAMPLES * cutoff))))
    q, v, a, tau = (x[few] for x in (motion.q, motion.v, motion.a, motion.tau))
    Y, model = regressor(robot.chain, q, v, a), np.zeros_like(tau)
    for j in range(robot.size):
        own = a[:, j], v[:, j], np.sign(v[:, j]), np.ones(len(v))
        X = np.column_stack([Y[:, j], *own])
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-12)
        model[:, j] = X / size @ np.linalg.lstsq(X / size, tau[:, j], rcond=_RANK)[0]
    rate = (len(q) - 1) / (motion.t[few][-1] - motion.t[0])
    band = torque_bandwidth([(tau, model)], rate, cutoff)
    if band < np.inf:
        remedy = "valid is torque as it was measured"
        yield Doubt("tau", (), FILTERED.format(band), remedy)


def doubts_of_physics(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Find wrong order, sign, unit and clock of a log, most reliable first."""
    if robot is None or not recording.has_torque:
        return
    masses = {"any": unit_masses(robot.chain)}
    clock_is_right = speeds_confirm_clock(state)
    if robot.chain.inertial.any():
        masses["file"] = robot.chain.inertial[:, :, None]
    for _ in range(_MOST_FAULTS):
        found = _better_reading(_Readings(robot, state, masses), clock_is_right)
        if found is None:
            return
        yield _doubt(recording, *found)
        state = found[0].of(state)


def _better_reading(
    log: _Readings, clock_is_right: bool
) -> tuple[OtherReading, Array, Array, str, Severity] | None:
    """Find the reading that is clearly better than the log as written.

    A short log is fitted well by any reading, and one of a hundred fits best by chance.
    The better one therefore has to gain on samples that a fit does not see as well,
    however the log is split.

    Returns:
        The reading, shares of variance left before and after, the masses that tell,
        and the severity; None if no reading is clearly better.
    """
    before = {masses: log.residual(log.written, masses) for masses in log.masses}
    floors = {masses: np.minimum(x, _FRICTION_ERROR) for masses, x in before.items()}
    improvable = [x for x in before if _gain(before[x], floors[x]) > _LEAST_GAIN]
    others = _others(log, clock_is_right) if improvable else []
    for masses in log.masses if others else ():
        gains = log.gains(others, masses, rounds=1)
        finalists = [others[k] for k in np.argsort(gains)[: -_FINALISTS - 1 : -1]]
        weighted = log.gains(finalists, masses)
        best = finalists[int(np.argmax(weighted))]
        if max(weighted) > _LEAST_GAIN:
            unseen = min(log.gains([best], masses, blocks=b)[0] for b in _SPLITS)
            if unseen > _EQUAL_GAIN:
                after = log.residual(best, masses)
                # Friction that lags at one joint looks like torque at another time.
                told = _gain(before[masses], after, best, elsewhere=bool(best.lag))
                sure = masses == "any" and min(unseen, told) > _LEAST_GAIN
                return best, before[masses], after, masses, error_if(sure)
        # A reading that needs impossible masses is not tested with the file's.
        others = [x for x, own in zip(others, gains, strict=True) if own > -_EQUAL_GAIN]
        if not others or "file" not in improvable:
            break
    return None


def _others(log: _Readings, clock_is_right: bool) -> list[OtherReading]:
    """Readings that are to be compared with the log as written."""
    from scipy.optimize import linear_sum_assignment

    moving = np.flatnonzero(np.ptp(log.state.q, axis=0) > STILL).tolist()
    pairs = np.log(log.columns(log.written, "any").residual_of_pairs())
    best = linear_sum_assignment(pairs)[1]
    others = list(readings(log.robot, moving, best, log.state.later))
    # Masses anywhere turn with a joint: its zero has to be told by the file's links.
    turned = [x for x in others if np.any(x.shift)]
    known = "file" in log.masses and turned
    gains = log.gains(turned, "file") if known else [0.0] * len(turned)
    doubted = [x for x, g in zip(turned, gains, strict=True) if g <= _LEAST_GAIN]
    doubted += [x for x in others if clock_is_right and x.channels == ("t",)]
    return [x for x in others if x not in doubted]


def _gain(
    before: Array,
    after: Array,
    reading: OtherReading | None = None,
    *,
    elsewhere: bool = False,
) -> float:
    """Log of the volume of residuals that a reading saves.

    Friction may be imitated by a scale of torque, which has to explain more than that,
    and at one joint by a scale of time, which has to explain others as well: the joint
    that gains most is left out then, and for all readings if asked ``elsewhere``.
    """
    scales = reading is not None and (np.abs(reading.factor) != 1.0).any()
    least = max(_SHARED * float(before.mean()), _SCALE_ERROR if scales else 0.0)
    gains = 0.5 * np.log(np.maximum(before, least) / np.maximum(after, least))
    elsewhere |= reading is not None and reading.clock != 1.0
    return float(gains.sum() - max(gains.max(), 0.0) * (elsewhere and len(gains) > 1))


def _doubt(
    recording: Recording,
    reading: OtherReading,
    before: Array,
    after: Array,
    masses: str,
    severity: Severity,
) -> Doubt:
    """Describe a better reading, with the residual at the joint that improves most."""
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
    gain = float(np.exp(_gain(before, after)))
    text = (
        f"{what}: read so, {_WHOSE[masses]} "
        f"{after[j]:.2g} of the variance of {recording.place('tau', j)} unexplained, "
        f"as logged {before[j]:.2g}"
    )
    return Doubt(reading.channels[0], reading.joints, text, _VALID, severity, gain)
