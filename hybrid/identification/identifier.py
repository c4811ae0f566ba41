"""Identification as an estimator of scikit-learn."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from hybrid.arrays import Array
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
    ) -> None:
        self.robot = robot
        self.estimator = estimator
        self.stages = stages
        self.cutoff = cutoff
        self.robust = robust
        self.consistent = consistent
        self.seed = seed

    def fit(self, X: Sequence[Recording], y: None = None) -> Self:
        """Identify from recordings, which hold the torque; ``y`` is not used."""
        settings = self.get_params(deep=False)
        self.fit_ = identify(settings.pop("robot"), X, **settings)
        return self

    def predict(self, X: Sequence[Recording]) -> list[Array]:
        """Torque along each recording, shape (N, n) each, [N·m]."""
        check_is_fitted(self)
        return [predict(self.fit_.model, x) for x in X]

    def score(self, X: Sequence[Recording], y: None = None) -> float:
        """Coefficient of determination R² of the torque, mean over the joints."""
        measured = np.concatenate([x.tau for x in X])
        residual = measured - np.concatenate(self.predict(X))
        return float(np.mean(1.0 - residual.var(axis=0) / measured.var(axis=0)))
