"""Choose the cut-off of the fit, and sum held-out squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.identification.data import FEWEST_PERIODS, FOLDS, Data, prepare
from hybrid.model.declared import declared_effects
from hybrid.recording import Recording
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.least_squares import OUTLYING, settle, without_folds
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion, speed_against_position

_HIDDEN = 0.05  # relative fall of the error that is worth half of the bandwidth
_MOST_HALVINGS = 3  # of the cut-off that the spectrum of positions suggests


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
    best, least = prepare(logs, None, speeds=speeds), np.inf
    highest = best.cutoff
    if not any(isinstance(x, Recording) for x in logs):
        return best
    shortest = min(float(m.t[-1] - m.t[0]) for m in best.motions)
    for halvings in range(_MOST_HALVINGS + 1):
        cutoff = highest / 2**halvings
        if cutoff * shortest < FEWEST_PERIODS * FOLDS:
            break
        data = (
            prepare(logs, cutoff, highest=highest, speeds=speeds) if halvings else best
        )
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
