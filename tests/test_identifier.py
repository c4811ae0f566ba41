"""Identification with scikit-learn's interface."""

import numpy as np
import pytest
from arms import MODELS
from coarse import Plant, simulate
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import cross_val_score

from hybrid import Identifier, identify, predict
from hybrid.effects import effect_class
from hybrid.plant import Noise
from hybrid.robot import Robot


@pytest.fixture(scope="module")
def logs():
    robot = Robot.load(MODELS / "planar.xml")
    friction = effect_class("coulomb")((0,), {"level": 2.0})
    plant = Plant(robot, [friction], nominal=robot, noise=Noise.typical(robot))
    return robot, simulate(plant, trajectories=3, duration=6.0, seed=1)


def test_it_is_the_public_function(logs):
    robot, recordings = logs
    own = Identifier(robot, estimator="ls", stages=("rigid",)).fit(recordings[:2])
    fit = identify(robot, recordings[:2], estimator="ls", stages=("rigid",))
    (tau,) = own.predict(recordings[2:])
    np.testing.assert_allclose(tau, predict(fit.model, recordings[2]))
    assert 0.9 < own.score(recordings[2:]) < 1.0


def test_scikit_learn_clones_and_cross_validates_it(logs):
    robot, recordings = logs
    given = Identifier(robot, stages=("rigid",), seed=3)
    copy = clone(given)
    assert copy is not given and copy.robot.fingerprint() == robot.fingerprint()
    assert (copy.stages, copy.seed) == (("rigid",), 3)
    with pytest.raises(NotFittedError):
        copy.predict(recordings)
    scores = cross_val_score(copy, recordings, cv=3)
    assert scores.shape == (3,) and scores.min() > 0.8
