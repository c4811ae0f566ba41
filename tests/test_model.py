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
from hybrid.identify import DynamicModel, identify, validate

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
    first, again = (json.loads(p.read_text()) for p in (saved, tmp_path / "again.json"))
    assert {k for k in first if first[k] != again[k]} <= {"arrays"}
    assert (
        saved.with_suffix(".safetensors").read_bytes()
        == (tmp_path / "again.safetensors").read_bytes()
    )


def test_a_model_that_was_fitted_without_a_cutoff_or_remainder_loads_too(
    fit, data, tmp_path
):
    model = replace(fit.model, cutoff=np.inf, remainder=None, simpler={})
    model.save(tmp_path / "plain.json")
    loaded = DynamicModel.load(tmp_path / "plain.json")
    assert loaded.cutoff == np.inf and loaded.remainder is None
    assert (loaded.predict(data[0]) == model.predict(data[0])).all()


def test_the_files_hold_text_and_numbers_but_no_code(saved):
    files = sorted(p.name for p in saved.parent.iterdir())
    assert files == ["model.json", "model.safetensors"]
    content = json.loads(saved.read_text(encoding="utf-8"))
    assert content["schema"].startswith("hybrid.model/")
    header = saved.with_suffix(".safetensors").read_bytes()
    size = int.from_bytes(header[:8], "little")
    kinds = {item["dtype"] for item in json.loads(header[8 : 8 + size]).values()}
    assert kinds == {"F64"}


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


def test_missing_files_are_named(saved):
    arrays = saved.with_suffix(".safetensors")
    arrays.rename(arrays.with_suffix(".away"))
    with pytest.raises(ModelFileError, match=r"model\.safetensors.*missing"):
        DynamicModel.load(saved)
    with pytest.raises(ModelFileError, match=r"nowhere\.json"):
        DynamicModel.load(saved.with_name("nowhere.json"))


@pytest.mark.parametrize("suffix", [".json", ".safetensors"])
def test_files_cut_off_anywhere_are_refused(saved, suffix):
    path = saved.with_suffix(suffix)
    whole = path.read_bytes()
    for share in (0.0, 0.001, 0.1, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ModelFileError):
            DynamicModel.load(saved)
    path.write_bytes(whole)
    DynamicModel.load(saved)


@pytest.mark.parametrize(
    "damage",
    [
        lambda c: c.pop("base"),
        lambda c: c.pop("effects"),
        lambda c: c.pop("robot"),
        lambda c: c.update(schema="hybrid.model/0"),
        lambda c: c["robot"].pop("chain"),
        lambda c: c.update(effects=3),
        lambda c: c.update(simpler=[]),
        lambda c: c["base"].update(kept=None),
        lambda c: c["remainder"][0].update(kind="unheard of"),
        lambda c: c["remainder"][0].update(positions=[0, 1, 0, 1]),
    ],
)
def test_damaged_content_is_refused_in_one_line(saved, damage):
    content = json.loads(saved.read_text())
    damage(content)
    saved.write_text(json.dumps(content))
    with pytest.raises(ModelFileError) as error:
        DynamicModel.load(saved)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["values", "mapping", "standing", "cutoff"])
def test_missing_arrays_are_refused(saved, name):
    from safetensors.numpy import load_file, save_file

    path = saved.with_suffix(".safetensors")
    arrays = load_file(path)
    del arrays[name]
    save_file(arrays, path)
    with pytest.raises(ModelFileError):
        DynamicModel.load(saved)
