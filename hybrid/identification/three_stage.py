"""Identification in three stages, iterated: rigid body, friction, learned remainder.

Every stage must lower the held-out error. A stage that does not is left out, for one
joint or for all, with a warning.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from hybrid.arguments import typed
from hybrid.effects import Effect
from hybrid.errors import warn
from hybrid.identification.fit import Fit
from hybrid.identification.identification import Identification
from hybrid.identification.preparation import (
    checked_logs,
    linear_effects,
    log_hash,
    products_at_best_cutoff,
)
from hybrid.recording import Recording
from hybrid.regression.least_squares import Estimator
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.signals.bandwidth import FILTERED
from hybrid.threads import one_thread

Stage = Literal["rigid", "friction", "ripple", "remainder"]
STAGES: tuple[Stage, ...] = ("rigid", "friction", "ripple", "remainder")


@one_thread
@typed
def identify(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    estimator: Estimator = "irls",
    stages: Sequence[Stage] = STAGES,
    effects: Sequence[Effect] = (),
    cutoff: float | None = None,
    robust: bool = False,
    consistent: bool = False,
    seed: int = 0,
) -> Fit:
    """Identify the drive torque of an arm from logs of its joints.

    Args:
        robot: The arm. Links, rotors and friction of its file are a prior, whose
            strength is chosen by the held-out error.
        recordings: Logs, or motions made from logs; masked samples are left out.
        estimator: The most elaborate that may be used: ``ls``, ``wls`` (weights per
            joint) or ``irls`` (full covariance across joints).
        stages: Stages to run; ``rigid`` is always run.
        effects: More effects, whose gains are identified with the rigid body.
        cutoff: Cut-off of columns and torque, [Hz]. By default it comes from the
            spectrum of the positions, halved while that lowers the held-out error.
        robust: Give less weight to blocks that do not fit (contacts, glitches).
        consistent: Make the links physically consistent, as near to the data as
            possible; undetermined parameters keep the values of the robot file.
            ``Fit.held_out`` shows the cost.
        seed: Seed of the mixtures' initial values.

    Returns:
        The model with covariance, held-out errors and undetermined parameters.

    Raises:
        IdentificationError: A cut-off too low or too high for the recordings, too
            little data, or a model that predicts unseen torque worse
            than the robot file does.
        RecordingError: A recording does not fit the arm, or has no torque.

    Warns:
        HybridWarning: A stage was left out, an iteration did not converge, the motion
            excites the arm poorly, the logged torque was low-pass filtered, or
            consistent links fit worse.
    """
    logs = checked_logs(robot, recordings)
    problem = build_problem(robot.chain, (*linear_effects(robot), *effects))
    products = products_at_best_cutoff(logs, problem, cutoff, robust=robust)
    terms = Identification(
        robot, products.data, estimator, tuple(effects), robust, seed
    )
    if products.data.band < np.inf:
        terms.warnings.append(FILTERED.format(products.data.band))
    held_out = terms.rigid_stage(products)
    later = {
        "friction": terms.friction_stage,
        "ripple": terms.ripple_stage,
        "remainder": terms.remainder_stage,
        "consistent": terms.consistent_stage,
    }
    for name, run in later.items():
        if name in stages or (consistent and name == "consistent"):
            run()
            held_out[f"+ {name}"] = terms.error
    fit = terms.fit(held_out)
    hashes = tuple(log_hash(log) for log in logs)
    fit = replace(fit, model=replace(fit.model, logs=hashes))
    for text in fit.warnings:
        warn(text)
    return fit
