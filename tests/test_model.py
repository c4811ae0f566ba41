"""A saved model: the same bits, no code, and nothing damaged passes for a model."""

import json
from dataclasses import replace

import numpy as np
import pytest
from simulated import (
    arm,
    coloured,
    linear_problem,
    motions,
    quiet,
    stacked,
    with_torque,
)

from hybrid.effects import effect_class
from hybrid.errors import ModelFileError
from hybrid.identification import DynamicModel, identify, validate

COUPLING = {"inertia": 0.1, "viscous": 0.6, "coulomb": 0.5}


def logs(count):
    """A planar arm with coupled gears, a bump over position, ripple, and noise."""
    robot = arm("planar")
    problem, rng = linear_problem(robot), np.random.default_rng(0)
    theta = rng.uniform(0.5, 1.5, problem.size)
    coupling = effect_class("transmission_coupling")((0, 1), COUPLING)
    found = []
    for motion in motions(robot, count=count, duration=10.0, rate=200):
        tau = stacked(problem, motion) @ theta + coupling.torque(motion, None)
        tau[:, 1] += 0.8 * np.tanh(4 * motion.q[:, 1]) * np.cos(2 * motion.q[:, 1])
        tau += coloured(rng, len(tau), 0.01 * np.eye(2), 0.9)
        found.append(with_torque(motion, tau))
    return found


@pytest.fixture(scope="module")
def data():
    return logs(6)


@pytest.fixture(scope="module")
def fit(data):
    """With columns of the user's own and a remainder."""
    own = [effect_class("transmission_coupling")((0, 1))]
    stages = ("rigid", "friction", "remainder")
    options = {"effects": own, "cutoff": 15.0, "stages": stages}
    return quiet(identify, arm("planar"), data[:4], **options)[0]


@pytest.fixture
def saved(fit, tmp_path):
    fit.model.save(tmp_path / "model.json")
    return tmp_path / "model.json"


def test_a_loaded_model_predicts_the_same_bits(fit, data, saved):
    loaded = DynamicModel.load(saved)
    assert fit.model.remainder is not None
    for motion in data:
        assert (loaded.predict(motion) == fit.model.predict(motion)).all()
        for name, simpler in fit.model.simpler.items():
            assert (
                loaded.simpler[name].predict(motion) == simpler.predict(motion)
            ).all()
    assert list(loaded.simpler) == list(fit.model.simpler)


def test_everything_that_was_saved_loads_back_equal(fit, saved, tmp_path):
    loaded = DynamicModel.load(saved)
    assert loaded.effects == fit.model.effects
    assert loaded.stage == fit.model.stage and loaded.cutoff == fit.model.cutoff
    assert loaded.base.names == fit.model.base.names
    for a, b in (
        (loaded.base.values, fit.model.base.values),
        (loaded.base.mapping, fit.model.base.mapping),
        (loaded.standing, fit.model.standing),
        *((loaded.range[name], x) for name, x in fit.model.range.items()),
    ):
        np.testing.assert_array_equal(a, b)
    loaded.save(tmp_path / "again.json")
    assert saved.read_bytes() == (tmp_path / "again.json").read_bytes()


def test_a_model_that_was_fitted_without_a_cutoff_or_remainder_loads_too(
    fit, data, tmp_path
):
    model = replace(fit.model, cutoff=np.inf, remainder=None, simpler={})
    model.save(tmp_path / "plain.json")
    loaded = DynamicModel.load(tmp_path / "plain.json")
    assert loaded.cutoff == np.inf and loaded.remainder is None
    assert (loaded.predict(data[0]) == model.predict(data[0])).all()


def test_a_model_is_one_file_of_text(saved):
    assert [p.name for p in saved.parent.iterdir()] == ["model.json"]
    content = json.loads(saved.read_text(encoding="utf-8"))
    assert content["schema"].startswith("hybrid.model/")


# --- columns of the user's own --------------------------------------------------------


def test_columns_of_the_user_go_through_fit_file_validation_and_prediction(
    fit, data, saved
):
    loaded = DynamicModel.load(saved)
    (found,) = [e for e in loaded.effects if e.id == "transmission_coupling"]
    for name in ("viscous", "coulomb"):
        assert found.values[name] == pytest.approx(COUPLING[name], rel=0.15)
        assert 0 < found.std[name] < 0.1
    # On parallel axes the coupled rotor turns as the last link does: no telling apart.
    assert found.values["inertia"] == 0.0
    assert any("transmission_coupling.inertia" in x for x in fit.unidentifiable)
    score = validate(loaded, data[4:])
    plain, _ = quiet(identify, arm("planar"), data[:4], cutoff=15.0, stages=("rigid",))
    without = validate(plain.model, data[4:])
    assert score.rows[0].mean < 0.8 * without.rows[0].mean
    assert [row.mean for row in score.rows] == [
        row.mean for row in validate(fit.model, data[4:]).rows
    ]


def test_one_gain_of_the_users_columns_may_be_off_without_the_others(fit, data):
    """The prediction is the sum of its terms: taking one away takes its torque."""
    motion = data[0]
    (own,) = [e for e in fit.model.effects if e.id == "transmission_coupling"]
    others = tuple(e for e in fit.model.effects if e is not own)
    less = replace(fit.model, effects=others)
    torque = own.torque(motion, fit.model.body(motion))
    difference = fit.model.predict(motion) - less.predict(motion)
    np.testing.assert_allclose(difference, torque, atol=1e-12)


# --- what is refused ------------------------------------------------------------------


def test_a_model_of_another_arm_is_refused(fit, data):
    with pytest.raises(ModelFileError, match="joints"):
        validate(fit.model, data[4:], robot=arm("coman_like"))


def test_an_arm_with_longer_links_is_another_arm(fit, data):
    robot = arm("planar")
    longer = replace(
        robot, chain=replace(robot.chain, translation=1.1 * robot.chain.translation)
    )
    with pytest.raises(ModelFileError, match="another arm"):
        validate(fit.model, data[4:], robot=longer)
    heavier = robot.with_inertial(2 * robot.chain.inertial)
    validate(fit.model, data[4:], robot=heavier)  # the same arm, known less well


def test_only_json_is_written_and_nothing_is_left_half_written(fit, tmp_path):
    with pytest.raises(ModelFileError, match=r"\.json"):
        fit.model.save(tmp_path / "model.pkl")
    assert list(tmp_path.iterdir()) == []


def test_a_file_cut_off_anywhere_is_refused(saved):
    whole = saved.read_bytes()
    for share in (0.0, 0.001, 0.1, 0.5, 0.9, 0.999):
        saved.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ModelFileError):
            DynamicModel.load(saved)
    saved.write_bytes(whole)
    DynamicModel.load(saved)
