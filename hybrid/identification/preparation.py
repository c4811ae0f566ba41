"""Preparation of logs for a fit: checks, filter, cut-off, cross-validation folds."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array, Index
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.stiffening_spring import StiffeningSpring
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError, warn
from hybrid.inspect import check_recordings
from hybrid.plant.joint_fields import declared_effects
from hybrid.recording import Recording
from hybrid.regression.cross_products import CrossProducts, accumulate
from hybrid.regression.data import Data, fastest
from hybrid.regression.least_squares import OUTLYING, solve_weighted, without_folds
from hybrid.regression.problem import Problem, part
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler, choose_cutoff, motion_from_recording
from hybrid.signals.bandwidth import band_of

_FOLDS = 4  # of cross-validation
_POSITION_CUTOFF = 2.0  # of the cut-off of columns and torque
_WORKING_RATE = 12.5  # of the cut-off: sampling rate of the decimated motions
_ALIAS_FREE = 5.0  # of the cut-off: torque below this is kept, above 6 is removed
STANDING = 0.01  # of the highest speed
SLOWEST = 0.002  # rad/s or m/s, speed that noise shows at rest
FEWEST_PERIODS = 3.0  # of the cut-off in a recording; filter edges take 2.3 of them
_WORTH_HALVING = 0.05  # relative fall of the error from which the cut-off is halved
_MOST_HALVINGS = 3  # of the cut-off from the spectrum of the positions


@typed
def checked_logs(
    robot: Robot, recordings: Sequence[Recording | Motion]
) -> list[Recording | Motion]:
    """Check logs, see :func:`check_recordings`; motions are not checked.

    A log that is given twice, under whatever name, counts once: its copy would be
    taken for motion that the fit has not seen.

    Raises:
        IdentificationError: There is no recording.
        RecordingError: A recording does not fit the arm.
    """
    logs: dict[tuple[str, str], Recording | Motion] = {}
    for x in recordings:
        own = check_recordings([x], robot) if isinstance(x, Recording) else [x]
        for log in own:
            first = logs.setdefault((log_hash(log), log_hash(log, log.q)), log)
            if first is not log:
                warn(f"{log.source}: the same log as {first.source}; it counts once")
    if not logs:
        raise IdentificationError("no recording given; at least one is needed")
    return list(logs.values())


def log_hash(log: Recording | Motion, signal: Array | None = None) -> str:
    """Hash of a signal of a log; that of its torque, the default, identifies the log.

    Masked samples do not count: the one half of a log is not the other.
    """
    x = log.tau if signal is None else signal
    offered = x[log.mask] if isinstance(log, Motion) else x
    return hashlib.sha256(np.ascontiguousarray(offered).tobytes()).hexdigest()[:16]


def motions_from_logs(
    logs: Sequence[Recording | Motion], cutoff: float | None
) -> tuple[list[Motion], float]:
    """Filter and differentiate checked logs; motions made from logs are not changed.

    Returns:
        Motions at full rate, and the cut-off of columns and torque, [Hz], which is that
        of the spectrum by default.

    Raises:
        IdentificationError: The cut-off is too low for the shortest log.
    """
    slowest = min(logs, key=lambda x: x.rate)
    if cutoff is None:
        chosen = [choose_cutoff(x) for x in logs if isinstance(x, Recording)]
        cutoff = float(np.median(chosen)) if chosen else np.inf
    elif slowest.rate / 2 < cutoff < np.inf:
        warn(
            f"{slowest.source}: a cut-off of {cutoff:g} Hz filters nothing; valid is "
            f"up to half of its rate, {slowest.rate / 2:.3g} Hz"
        )
    shortest = min(float(x.t[-1] - x.t[0]) for x in logs)
    if not cutoff * shortest >= FEWEST_PERIODS:
        raise IdentificationError(
            f"cutoff is {cutoff:g} Hz; valid is {FEWEST_PERIODS / shortest:.3g} Hz or "
            f"more for a recording of {shortest:.3g} s"
        )
    motions = [
        motion_from_recording(x, cutoff=_POSITION_CUTOFF * cutoff)
        if isinstance(x, Recording)
        else x
        for x in logs
    ]
    return motions, cutoff


def prepare(
    logs: Sequence[Recording | Motion],
    cutoff: float | None,
    *,
    highest: float | None = None,
) -> Data:
    """Data of a fit, with cross-validation folds.

    Four or more recordings are assigned to folds as a whole; of fewer, each is cut into
    quarters. Neighbouring samples are too similar to validate on, and a model must hold
    on motions that it has not seen.

    Args:
        logs: Checked logs, see :func:`checked_logs`, or motions made from them.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum by default.
        highest: Cut-off for which motions are decimated, [Hz]; ``cutoff`` by default.

    Raises:
        IdentificationError: Every sample is masked, or the cut-off is too low.
    """
    motions, cutoff = motions_from_logs(logs, cutoff)
    motions = [decimated_motion(m, highest or cutoff) for m in motions if m.mask.any()]
    if not motions:
        raise IdentificationError("no usable sample: every one is masked")
    standing = standing_speed(motions)
    return Data(tuple(motions), tuple(_folds(motions, standing)), cutoff, standing)


def standing_speed(motions: Sequence[Motion]) -> Array:
    """Speed of each joint below which it stands, shape (n,), [rad/s]."""
    return np.maximum(STANDING * fastest(motions), SLOWEST)


def _folds(motions: Sequence[Motion], standing: Array) -> list[Index]:
    found = []
    for r, motion in enumerate(motions):
        if len(motions) >= _FOLDS:
            found.append(np.full(len(motion.t), r % _FOLDS))
        else:  # quarters of the moving samples, not of the standstill around them
            moves = np.any(np.abs(motion.v) > standing, axis=1) & motion.mask
            found.append(_FOLDS * np.cumsum(moves) // (1 + int(moves.sum())))
    return found


def decimated_motion(motion: Motion, cutoff: float) -> Motion:
    """Decimate a motion to about twelve samples in a period of the cut-off, [Hz].

    Positions are filtered at twice the cut-off, so they lose nothing. The torque loses
    what is above five times the cut-off.
    """
    factor = int(motion.rate / (_WORKING_RATE * cutoff))
    if factor < 2:
        return motion
    tau = Sampler(motion.rate, _ALIAS_FREE * cutoff, factor)(motion.tau)
    return replace(part(motion, slice(None, None, factor)), tau=tau)


def linear_effects(robot: Robot) -> list[Effect]:
    """Rotor, offset and linear friction of every joint, and other effects of its file.

    A joint with a spring gets no offset: that is the preload of the spring.
    """
    classes = (Armature, TorqueOffset, Coulomb, Viscous)
    sprung = np.flatnonzero(robot.stiffness)
    usual = [
        cls((j,))
        for cls in classes
        for j in range(robot.size)
        if not (cls is TorqueOffset and j in sprung)
    ]
    more = (Spring, NonlinearViscous, TransmissionCoupling, StiffeningSpring)
    found = [e for e in declared_effects(robot) if isinstance(e, more)]
    return [*usual, *(type(e)(e.joints, e.shape_values) for e in found)]


def products_at_best_cutoff(
    logs: Sequence[Recording | Motion],
    problem: Problem,
    cutoff: float | None = None,
    *,
    robust: bool,
) -> CrossProducts:
    """Products at the cut-off with which a linear model predicts held-out torque best.

    The first cut-off comes from the spectrum of the positions. Torque may be noisy at
    lower frequencies, and dry friction is noisy where the speed is. So the cut-off is
    halved while that lowers the held-out error of weighted least squares by more than
    the friction which it hides may be worth. Torque that its logger has low-pass
    filtered is compared through that filter.

    The logs are those of :func:`checked_logs`. A cut-off that is given, [Hz], is used.

    Raises:
        IdentificationError: Every sample is masked, or the cut-off is too low.
    """

    def solutions(products: CrossProducts) -> Array:
        found = solve_weighted(products, "wls", robust=robust)
        return without_folds(products, found)

    data = prepare(logs, cutoff)
    best = accumulate(problem, data)
    theta = solutions(best)
    left = data.held_out_residual(problem, theta)
    models = [m.tau - x for m, x in zip(data.motions, left, strict=True)]
    band = band_of(data.motions, models, data.cutoff)
    if band < np.inf:
        return accumulate(problem, replace(data, band=band))
    if cutoff is not None or not any(isinstance(x, Recording) for x in logs):
        return best
    shortest = min(float(m.t[-1] - m.t[0]) for m in data.motions)
    least = _level(best, theta, robust)
    for halvings in range(1, _MOST_HALVINGS + 1):
        cutoff = data.cutoff / 2**halvings
        if cutoff * shortest < FEWEST_PERIODS * data.fold_count:
            break
        lower = accumulate(problem, prepare(logs, cutoff, highest=data.cutoff))
        level = _level(lower, solutions(lower), robust)
        if level > least - _WORTH_HALVING:
            break
        best, least = lower, level
    return best


def _level(products: CrossProducts, theta: Array, robust: bool) -> float:
    """Mean log of the held-out RMS torque of the joints, by :func:`without_folds`."""
    squares = summed_squares(products.held_out_squares(theta), robust)
    error = np.sqrt(squares / products.data.moving)
    return float(np.log(np.maximum(error, 1e-300)).mean())


def summed_squares(squares: Array, robust: bool) -> Array:
    """Sum of squares over blocks, shape (n,); if robust, outlying blocks count less."""
    if robust:
        squares = np.minimum(squares, OUTLYING * np.median(squares, axis=0))
    return np.asarray(squares.sum(axis=0))
