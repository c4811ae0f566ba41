"""Find samples that no arm produces: too few, too large, constant, frozen."""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.inspect.doubt import Doubt
from hybrid.inspect.stuck import fewest_repeats, repeats, stretches, stuck_torque
from hybrid.recording import Recording
from hybrid.recording.clock import GAP, PART
from hybrid.recording.recording import row_words
from hybrid.robot import Robot

SHORTEST = 1.0  # s
FEWEST = 100  # samples
STILL = 1e-3  # rad: a joint that travels less is at rest
_SAG = 0.1  # rad: a load may move a held joint so far
SLOWEST = 1.0  # Hz: lowest sampling rate of a moving arm
LARGEST = 1e9  # rad, rad/s, N·m: beyond any arm, and its square is finite
LATEST = 1e19  # s: more than the nanoseconds since 1970, which the step reveals
_MEASURED = "valid is a torque that was measured"
_COUNTS, _UNEVEN = 1e5, 0.1  # steps of an encoder between samples; error of a step
_COARSEST = 0.01  # rad: worst resolution of a joint encoder
_UNITS = (1e-3, "milli"), (1e-6, "micro"), (1e-9, "nano")
_SUDDEN = 5.0  # times a large change of the step of a position
_USUAL_RATE = 20.0, 2e4  # Hz


def doubts_of_samples(
    recording: Recording, robot: Robot | None = None
) -> Iterator[Doubt]:
    """Find wrong samples, whatever the arm; errors first."""
    yield from _size(recording)
    yield from _clock(recording)
    yield from _motion(recording)
    if recording.has_torque:
        yield from _torque(recording)
    yield from _frozen(recording)


def large_step(x: Array) -> float:
    """99 % quantile of the steps of a position, shape (N,); at least its resolution."""
    return max(float(np.quantile(np.abs(np.diff(x)), 0.99)), resolution(x, _COARSEST))


def resolution(x: Array, coarsest: float = np.inf) -> float:
    """Resolution of the encoder of a position, shape (N,), from its smallest step."""
    steps = np.abs(np.diff(x))
    return float(np.min(steps[steps > 0], initial=coarsest))


def encoder_step(q: Array) -> float:
    """Step of an encoder, by its position, shape (N,); infinite if there is none.

    All changes of the position are multiples of it. Those of a log that was resampled
    or simulated are multiples of nothing.
    """
    steps, least = np.abs(np.diff(q)), resolution(q)
    few = steps[(steps > 0) & (steps < _COUNTS * least)] / least
    whole = np.abs(few - np.round(few)) < _UNEVEN
    usual = float(np.median(steps[steps > 0])) if few.size else np.inf
    return least if usual < _COUNTS * least and whole.mean() > 1 - _UNEVEN else np.inf


def stuck_position(t: Array, q: Array) -> Mask:
    """Samples at which the position of a joint is frozen, (N,).

    At rest it repeats as well, but it comes to rest and leaves it as gradually as it
    changes its speed elsewhere.

    Args:
        t: Time, shape (N,), [s].
        q: Position, shape (N,), [rad].
    """
    runs, bend = repeats(q, fewest_repeats(t)), np.abs(np.diff(q, 2))
    elsewhere = bend[~(runs[:-2] | runs[1:-1] | runs[2:])]
    least = np.min(bend[bend > 0], initial=_COARSEST)
    usual = max(np.quantile(np.append(elsewhere, least), 0.99), least)
    frozen = np.zeros_like(runs)
    for run in stretches(runs):
        ends = [k for k in (run.start - 1, run.stop - 2) if 0 <= k < len(bend)]
        frozen[run] = np.any(bend[ends] > _SUDDEN * usual)
    return frozen


def _clock(recording: Recording) -> Iterator[Doubt]:
    steps = np.diff(recording.t)
    step = float(np.median(steps))
    if step * SLOWEST < 1.0:
        gaps = np.flatnonzero(steps > GAP * step)
        if len(gaps):  # else the log would have been split
            text = (
                f"t, {row_words(int(gaps[0]) + 1)}: first of {len(gaps)} gaps of more "
                f"than {GAP} steps, and no part between them lasts {PART:g} s"
            )
            yield Doubt("t", (), text, "valid are longer parts", "error", len(gaps))
        return
    what = "no arm is logged so rarely"
    for unit, name in _UNITS:
        if _USUAL_RATE[0] < 1.0 / (step * unit) < _USUAL_RATE[1]:
            what = f"time looks to be in {name}seconds"
    text = f"t: the median step is {step:.6g} s: {what}"
    yield Doubt("t", (), text, "valid are seconds", "error", step)


def _size(recording: Recording) -> Iterator[Doubt]:
    samples = len(recording.t)
    if recording.duration < SHORTEST or samples < FEWEST:
        text = f"too short: {samples} samples in {recording.duration:.3g} s"
        remedy = f"valid are {FEWEST} samples and {SHORTEST:g} s or more"
        yield Doubt("t", (), text, remedy, "error", samples)
    if np.abs(recording.t).max() > LATEST:
        text = f"t: {recording.t[np.argmax(np.abs(recording.t))]:.6g} s"
        yield Doubt("t", (), text, f"valid are times up to {LATEST:g} s", "error")
    for name, x in recording.channels.items():
        if np.abs(x).max() > LARGEST:
            row, joint = np.unravel_index(int(np.argmax(np.abs(x))), x.shape)
            text = f"{recording.place(name, int(joint), int(row))}: {x[row, joint]:.6g}"
            remedy = f"valid are numbers up to {LARGEST:g}"
            yield Doubt(name, (int(joint),), text, remedy, "error", x[row, joint])


def _motion(recording: Recording) -> Iterator[Doubt]:
    travel = np.ptp(recording.q, axis=0)
    if np.all(travel < STILL):
        text = f"q: no joint moves more than {travel.max():.2g} rad"
        remedy = f"valid is a log in which the arm moves by {STILL:g} rad or more"
        yield Doubt("q", (), text, remedy, "error", float(travel.max()))
    # A joint is at rest if its command or its speed is constant as well.
    others = [recording.command, recording.v]
    known = [np.ptp(x, axis=0) == 0 for x in others if x is not None]
    resting = np.any(known, axis=0) if known else np.zeros(recording.size, dtype=bool)
    for joint in np.flatnonzero((travel == 0) & ~resting).tolist():
        yield Doubt("q", (joint,), f"{recording.place('q', joint)} is constant")
    moves = np.flatnonzero(travel >= STILL).tolist()
    if len(moves) == 1 < recording.size - 1:
        text = f"only {recording.place('q', moves[0])} moves"
        remedy = "masses that only the other joints feel are not told by this log"
        yield Doubt("q", (moves[0],), text, remedy, evidence=1)
    for channel, least in (("v", STILL), ("command", _SAG)):
        x = recording.channels.get(channel)
        if x is None:
            continue
        constant = (np.ptp(x, axis=0) == 0) & (travel > least)
        for joint in np.flatnonzero(constant).tolist():
            text = (
                f"{recording.place(channel, joint)} is constant while the joint moves"
            )
            yield Doubt(channel, (joint,), text)


def _torque(recording: Recording) -> Iterator[Doubt]:
    tau = recording.tau
    # The square of a denormal number is zero.
    constant = (np.ptp(tau, axis=0) == 0) | (np.abs(tau).max(axis=0) < 1 / LARGEST)
    for joint in np.flatnonzero(constant).tolist():
        text = f"{recording.place('tau', joint)} is constant ({tau[0, joint]:g})"
        yield Doubt("tau", (joint,), text, _MEASURED, "error")
    first = np.argmax([(tau.T == x).all(axis=1) for x in tau.T], axis=1)
    for joint in np.flatnonzero(~constant & (first < np.arange(len(first)))).tolist():
        twins = int(first[joint]), joint
        places = " and ".join(recording.place("tau", k) for k in twins)
        text = f"{places} are the same in every row"
        yield Doubt("tau", twins, text, _MEASURED, "error")
    for joint, x in enumerate(tau.T):
        frozen, saturated = stuck_torque(recording.t, recording.q, x)
        for limit in np.unique(x[saturated]).tolist():
            share = float(np.mean(x == limit))
            where = recording.place("tau", joint)
            text = f"{where} stays at {limit:.6g} for {share:.1%}: saturated?"
            yield Doubt("tau", (joint,), text, evidence=share)
        yield from _frozen_joint(recording, "tau", joint, frozen)


def _frozen(recording: Recording) -> Iterator[Doubt]:
    both = np.hstack([recording.q, recording.tau])
    moved = np.any(np.diff(both, axis=0) != 0, axis=1)  # NaN differs from itself
    rests = [(run.stop - run.start + 1, run.start) for run in stretches(~moved)]
    length, row = max(rests, key=lambda rest: rest[0], default=(1, 0))
    if length > 10:
        text = f"all channels repeat for {length} samples from {row_words(row)}"
        yield Doubt("q", (), f"{text}: did the log stop?", evidence=length)
    for joint, x in enumerate(recording.q.T):
        frozen = stuck_position(recording.t, x)
        yield from _frozen_joint(recording, "q", joint, frozen)


def _frozen_joint(
    recording: Recording, channel: str, joint: int, frozen: Mask
) -> Iterator[Doubt]:
    if frozen.any():
        length, start = max((x.stop - x.start, x.start) for x in stretches(frozen))
        where = recording.place(channel, joint, start)
        text = f"{where}: frozen for {length} samples"
        yield Doubt(channel, (joint,), text, evidence=length)
