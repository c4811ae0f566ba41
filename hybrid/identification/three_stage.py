"""Identification in three stages, iterated: rigid body, friction, learned remainder.

Every stage must lower the error on samples that it was not fitted on; one that does not
is left out, for the joint concerned or altogether, with a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Literal

from hybrid.effects import Effect
from hybrid.effects.registry import check_effects
from hybrid.errors import HybridWarning, IdentificationError
from hybrid.identification.fit import Fit
from hybrid.identification.identification import Identification
from hybrid.identification.preparation import prepare, prepared, taken
from hybrid.recording import Recording
from hybrid.regression.least_squares import ESTIMATORS, Estimator
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.threads import one_thread

Stage = Literal["rigid", "friction", "ripple", "remainder"]
STAGES: tuple[Stage, ...] = ("rigid", "friction", "ripple", "remainder")


@one_thread
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
        robot: The arm; its links, rotors and friction are a prior, as strong as helps.
        recordings: Logs, or motions made from them whose masks leave samples out.
        estimator: The last rung that may be taken of ``ls``, ``wls`` and ``irls``, the
            one with the full covariance across joints.
        stages: Which of the stages to run; ``rigid`` always does.
        effects: More effects whose gains are to be found along with the rigid body.
        cutoff: Cut-off of columns and torque, [Hz]; if not given, that of the spectrum
            of positions or a half, a quarter, … of it, by the error on unseen samples.
        robust: Weigh down stretches that do not fit (contacts, glitches).
        consistent: Give the links parameters of bodies that could be built, as near
            to the data as they can be; what the data leave open stays as the robot
            file says. ``Fit.held_out`` shows what that costs.
        seed: Seed of the mixtures' starts.

    Returns:
        The model with covariance, held-out errors and what could not be told.

    Raises:
        IdentificationError: Unknown estimator or stage, a cut-off too low for the
            recordings, too little data, or a model that predicts unseen torque worse
            than the robot file does.
        RecordingError: A recording does not fit the arm, or has no torque.

    Warns:
        HybridWarning: A stage was left out, an iteration did not converge, the motion
            excites the arm poorly, or consistent links fit worse.
    """
    _check_choices(estimator, stages)
    check_effects(effects)
    logs = taken(robot, recordings)
    data = (
        prepared(robot, logs, effects, robust)
        if cutoff is None
        else prepare(logs, cutoff)
    )
    terms = Identification(robot, data, estimator, tuple(effects), robust, seed)
    held_out = terms.plain()
    rungs = {
        "friction": terms.bend,
        "ripple": terms.ripple,
        "remainder": terms.learn,
        "consistent": terms.constrain,
    }
    for name, climb in rungs.items():
        if name in stages or (consistent and name == "consistent"):
            climb()
            held_out[f"+ {name}"] = terms.error
    fit = terms.fit(held_out)
    for text in fit.warnings:
        warnings.warn(text, HybridWarning, stacklevel=2)
    return fit


def _check_choices(estimator: str, stages: Sequence[str]) -> None:
    if estimator not in ESTIMATORS:
        raise IdentificationError(
            f"no estimator {estimator!r}; valid are {', '.join(ESTIMATORS)}"
        )
    unknown = [s for s in stages if s not in STAGES]
    if unknown:
        raise IdentificationError(
            f"no stage {', '.join(unknown)}; valid are {', '.join(STAGES)}"
        )
