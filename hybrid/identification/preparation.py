"""Logs -> data of a fit: checked, filtered, dealt into folds, at the best cut-off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError
from hybrid.identification.data import FOLDS, Data, fastest
from hybrid.inspect import check_recordings
from hybrid.model.declared import declared_effects
from hybrid.recording import Recording
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.least_squares import OUTLYING, settle, without_folds
from hybrid.regression.problem import build_problem, part
from hybrid.robot import Robot
from hybrid.signals import (
    Motion,
    Sampler,
    SpeedCheck,
    choose_cutoff,
    motion_from_recording,
    speed_against_position,
)

_POSITION_CUTOFF = 2.0  # of the cut-off of columns and torque
_WORKING_RATE = 12.5  # of the cut-off: three times what positions can hold
_ALIAS_FREE = 5.0  # of the cut-off: torque below passes, torque above 6 does not
STANDING = 0.01  # of the highest speed
FEWEST_PERIODS = 3.0  # of the cut-off in a recording: its edges take 2.3 of them
_HIDDEN = 0.05  # relative fall of the error that is worth half of the bandwidth
_MOST_HALVINGS = 3  # of the cut-off that the spectrum of positions suggests


def prepare_motions(
    robot: Robot, recordings: Sequence[Recording | Motion], cutoff: float | None
) -> tuple[list[Motion], float]:
    """Check, filter and differentiate recordings; motions pass as they are.

    Args:
        robot: The arm.
        recordings: Logs of it, or motions made from such.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.

    Returns:
        Motions at full rate and the cut-off.

    Raises:
        IdentificationError: There is no recording, or the cut-off is too low for the
            shortest.
        RecordingError: A recording does not fit the arm.
    """
    return motions_of(taken(robot, recordings), cutoff)


def taken(
    robot: Robot, recordings: Sequence[Recording | Motion]
) -> list[Recording | Motion]:
    """Check logs (see :func:`check_recordings`); motions pass as they are."""
    if not recordings:
        raise IdentificationError("no recording given; at least one is needed")
    logs: list[Recording | Motion] = []
    for x in recordings:
        logs += check_recordings([x], robot) if isinstance(x, Recording) else [x]
    return logs


def motions_of(
    logs: Sequence[Recording | Motion],
    cutoff: float | None,
    speeds: Sequence[SpeedCheck | None] = (),
) -> tuple[list[Motion], float]:
    """Filter and differentiate logs that were checked; see :func:`prepare_motions`."""
    if cutoff is None:
        chosen = [choose_cutoff(x) for x in logs if isinstance(x, Recording)]
        cutoff = float(np.median(chosen)) if chosen else np.inf
    shortest = min(float(x.t[-1] - x.t[0]) for x in logs)
    if not cutoff * shortest >= FEWEST_PERIODS:
        raise IdentificationError(
            f"cutoff is {cutoff:g} Hz; valid is {FEWEST_PERIODS / shortest:.3g} Hz or "
            f"more for a recording of {shortest:.3g} s"
        )
    motions = [
        motion_from_recording(x, cutoff=_POSITION_CUTOFF * cutoff, speed=speed)
        if isinstance(x, Recording)
        else x
        for x, speed in zip_longest(logs, speeds)
    ]
    return motions, cutoff


def prepare(
    logs: Sequence[Recording | Motion],
    cutoff: float | None,
    *,
    highest: float | None = None,
    speeds: Sequence[SpeedCheck | None] = (),
) -> Data:
    """Deal motions into folds for cross-validation.

    Whole recordings make the folds where there are four or more, else the quarters of
    each: neighbouring samples are too alike to score on, and a model has to hold on
    motions that it has not seen.

    Args:
        logs: Logs that were checked, see :func:`taken`, or motions made from such.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
        highest: Cut-off for which motions are thinned, [Hz]; the same if not given.
        speeds: What the measured speed of each log is worth, if that is known.
    """
    motions, cutoff = motions_of(logs, cutoff, speeds)
    motions = [thinned(m, highest or cutoff) for m in motions if m.mask.any()]
    if not motions:
        raise IdentificationError("no usable sample: every one is masked")
    standing = STANDING * fastest(motions)
    return Data(tuple(motions), tuple(_folds(motions, standing)), cutoff, standing)


def _folds(motions: Sequence[Motion], standing: Array) -> list[NDArray[np.intp]]:
    found = []
    for r, motion in enumerate(motions):
        if len(motions) >= FOLDS:
            found.append(np.full(len(motion.t), r % FOLDS))
        else:  # quarters of the motion, not of the rest before and after it
            moves = np.any(np.abs(motion.v) > standing, axis=1) & motion.mask
            found.append(FOLDS * np.cumsum(moves) // (1 + int(moves.sum())))
    return found


def thinned(motion: Motion, cutoff: float) -> Motion:
    """A motion at about a dozen samples a period of the cut-off.

    Positions hold nothing above twice the cut-off, so laws of them lose nothing; torque
    loses what is above five times the cut-off, where no smooth law has much.

    Args:
        motion: Motion at its full rate.
        cutoff: Cut-off of columns and torque, [Hz]; inf keeps every sample.
    """
    factor = int(motion.rate / (_WORKING_RATE * cutoff))
    if factor < 2:
        return motion
    tau = Sampler(motion.rate, _ALIAS_FREE * cutoff, factor)(motion.tau)
    return replace(part(motion, slice(None, None, factor)), tau=tau)


def linear_effects(robot: Robot) -> list[Effect]:
    """Rotor, offset and linear friction of every joint, and what else its file has.

    The preload of a spring is the offset of its joint.
    """
    classes = (Armature, TorqueOffset, Coulomb, Viscous)
    sprung = np.flatnonzero(robot.stiffness)
    usual = [
        cls((j,))
        for cls in classes
        for j in range(robot.size)
        if not (cls is TorqueOffset and j in sprung)
    ]
    more = (Spring, NonlinearViscous)
    found = [e for e in declared_effects(robot) if isinstance(e, more)]
    return [*usual, *(type(e)(e.joints) for e in found)]


def prepared(
    robot: Robot,
    logs: Sequence[Recording | Motion],
    extra: Sequence[Effect],
    robust: bool,
) -> Data:
    """Recordings at the cut-off whose plain model predicts unseen torque best.

    The spectrum of positions says up to where they hold motion. Torque may be noisy
    sooner, and friction chatters where speeds do: the cut-off is halved while that
    lowers the held-out error of weighted least squares, at the rate of the log, by more
    than what it hides of friction may be worth.

    Args:
        robot: The arm.
        logs: Logs that were checked, or motions made from them, which keep their own.
        extra: Effects of the user.
        robust: Weigh down stretches that do not fit.
    """
    problem = build_problem(robot.chain, (*linear_effects(robot), *extra))
    speeds = [
        speed_against_position(x) if isinstance(x, Recording) else None for x in logs
    ]
    best = data = prepare(logs, None, speeds=speeds)
    highest, least = best.cutoff, np.inf
    if not any(isinstance(x, Recording) for x in logs):
        return best
    shortest = min(float(m.t[-1] - m.t[0]) for m in best.motions)
    for halvings in range(_MOST_HALVINGS + 1):
        cutoff = highest / 2**halvings
        if cutoff * shortest < FEWEST_PERIODS * FOLDS:
            break
        if halvings:
            data = prepare(logs, cutoff, highest=highest, speeds=speeds)
        products = data.products(problem)
        found = settle(products, "wls", robust=robust)
        theta = without_folds(products, found.weight, folds=FOLDS, share=found.share)
        error = np.sqrt(total(scored(products, theta), robust) / data.moving)
        level = float(np.log(np.maximum(error, 1e-300)).mean())
        if level > least - _HIDDEN:
            break
        best, least = data, level
    return best


def total(squares: Array, robust: bool) -> Array:
    """Sum of squares over blocks, shape (n,); if robust, outlying blocks count less."""
    if robust:
        squares = np.minimum(squares, OUTLYING * np.median(squares, axis=0))
    return np.asarray(squares.sum(axis=0))


def scored(products: CrossProducts, theta: Array) -> Array:
    """Held-out squares of each block by solutions without each fold, (F, p)."""
    assert products.scores is not None
    return products.scores.squares(theta)
