"""Identification as an estimator of scikit-learn."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_is_fitted

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.errors import RecordingError
from hybrid.identification.fit import Fit
from hybrid.identification.three_stage import STAGES, Stage, identify
from hybrid.identification.validation import predict
from hybrid.recording import Recording
from hybrid.regression.least_squares import Estimator
from hybrid.robot import Robot


class Identifier(BaseEstimator):  # type: ignore[misc]
    """:func:`identify` as an estimator; one recording is one sample.

    scikit-learn can clone it, search over its parameters and cross-validate it. The
    parameters are those of :func:`identify`.

    Attributes:
        fit_: The result of :func:`identify`.
    """

    fit_: Fit

    def __init__(
        self,
        robot: Robot,
        *,
        estimator: Estimator = "irls",
        stages: Sequence[Stage] = STAGES,
        cutoff: float | None = None,
        robust: bool = False,
        consistent: bool = False,
        seed: int = 0,
        effects: Sequence[Effect] = (),
    ) -> None:
        self.robot = robot
        self.estimator = estimator
        self.stages = stages
        self.cutoff = cutoff
        self.robust = robust
        self.consistent = consistent
        self.seed = seed
        self.effects = effects

    @typed
    def fit(self, X: Sequence[Recording], y: None = None) -> Self:
        """Identify from recordings, which hold the torque; ``y`` is not used."""
        settings = self.get_params(deep=False)
        self.fit_ = identify(settings.pop("robot"), X, **settings)
        return self

    @typed
    def predict(self, X: Sequence[Recording]) -> list[Array]:
        """Torque along each recording, shape (N, n) each, [N·m]; see :func:`predict`.

        Raises:
            RecordingError: A recording does not fit the arm.
        """
        check_is_fitted(self)
        return [predict(self.fit_.model, x) for x in X]

    @typed
    def score(self, X: Sequence[Recording], y: None = None) -> float:
        """Coefficient of determination R² of the torque, mean over the joints.

        Joints whose torque does not change do not count.

        Raises:
            RecordingError: A recording does not fit the arm, or has no torque.
        """
        check_is_fitted(self)
        for x in X:
            if not x.has_torque:
                raise RecordingError(f"{x.source or 'recording'}: no torque to predict")
        logs = [x.in_order(self.robot.joints) for x in X]
        pair = (x.tau for x in logs), self.predict(logs)
        measured, predicted = (np.concatenate([*x]) for x in pair)
        known = np.isfinite(measured - predicted).all(axis=1)
        changes = np.ptp(measured[known], axis=0) > 0
        at = np.ix_(known, changes)
        return float(r2_score(measured[at], predicted[at]))
