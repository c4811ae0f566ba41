"""Identification with scikit-learn's interface."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from coarse import Plant, simulate
from simulated import quiet
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.metrics import r2_score
from sklearn.model_selection import cross_val_score

from hybrid import Identifier, identify, predict
from hybrid.effects import effect_class
from hybrid.errors import HybridWarning, RecordingError
from hybrid.plant import Noise
from hybrid.robot import Robot


@pytest.fixture(scope="module")
def logs():
    robot = Robot.load(MODELS / "planar.xml")
    friction = effect_class("coulomb")((0,), {"level": 2.0})
    plant = Plant(robot, [friction], nominal=robot, noise=Noise.typical(robot))
    return robot, simulate(plant, trajectories=3, duration=6.0, seed=1)


@pytest.fixture(scope="module")
def own(logs):
    robot, recordings = logs
    given = Identifier(robot, estimator="ls", stages=("rigid",))
    return given.fit(recordings[:2])


def test_it_is_the_public_function(logs, own):
    robot, recordings = logs
    fit = identify(robot, recordings[:2], estimator="ls", stages=("rigid",))
    (tau,) = own.predict(recordings[2:])
    np.testing.assert_allclose(tau, predict(fit.model, recordings[2]))
    assert 0.9 < own.score(recordings[2:]) < 1.0


def cut(x, rows):
    return replace(x, t=x.t[rows], **{n: c[rows] for n, c in x.channels.items()})


def test_its_score_is_that_of_scikit_learn_whatever_the_log_is_like(logs, own):
    """It once passed over a bias, and took columns and rows for those of the robot."""
    robot, (*_, x) = logs
    wrong = replace(x, tau=x.tau + [4.0, 1.0])
    expected = r2_score(wrong.tau, own.predict(wrong)[0])
    assert own.score(wrong) == pytest.approx(expected) and expected < 0.9
    turned = x.in_order(robot.joints[::-1])
    (tau,), (back,) = own.predict(x), own.predict(turned)
    np.testing.assert_allclose(back[:, ::-1], tau, atol=1e-8)
    assert own.score([turned]) == pytest.approx(own.score([x]))
    rng = np.random.default_rng(0)
    kept = np.sort(rng.choice(len(x.t), round(0.8 * len(x.t)), replace=False))
    with pytest.warns(HybridWarning, match="irregular clock"):
        found = own.score([cut(x, kept)])
    assert found == pytest.approx(own.score([x]), abs=0.02)
    with pytest.raises(RecordingError, match="no torque to predict"):
        own.score([replace(x, tau=None)])


def test_what_is_predicted_has_the_rows_of_the_log(logs, own):
    model, (*_, x) = own.fit_.model, logs[1]
    whole = predict(model, x)
    for lost in (range(1000, 1001), range(1000, 1040), range(2, 1500, 3)):
        rows = np.delete(np.arange(len(x.t)), lost)
        found, _ = quiet(predict, model, cut(x, rows))
        assert found.shape == (len(rows), 2)
        size = np.abs(whole).max()
        off = np.abs(found - whole[rows])  # dry friction turns a row earlier or later
        assert np.quantile(off, 0.98) < 0.01 * size
    short = np.r_[0:1000, 1200:1300, 1500 : len(x.t)]  # a part of a fifth of a second
    found, _ = quiet(predict, model, cut(x, short))
    left = np.isnan(found).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(left), np.arange(1000, 1100))
    assert np.isfinite(found[~left]).all()


def test_it_takes_effects_and_is_copied_before_and_after_use(logs):
    robot, recordings = logs
    spring = effect_class("spring")((1,), {"stiffness": 0.0})
    own = Identifier(robot, stages=("rigid",), effects=[spring]).fit(recordings[:2])
    assert "spring" in {e.id for e in own.fit_.model.effects}
    (tau,) = own.predict(recordings[2])
    again = pickle.loads(pickle.dumps(own))
    np.testing.assert_array_equal(again.predict(recordings[2])[0], tau)


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
