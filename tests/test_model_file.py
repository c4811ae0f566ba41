"""Saved models: equal when read back, and refused in one line when damaged."""

import hashlib
import json
import os
import stat
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import MODELS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save

from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import ModelFileError, RobotError
from hybrid.identify import DynamicModel
from hybrid.identify.model_file import SCHEMA
from hybrid.identify.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

model_file = sys.modules["hybrid.identify.model_file"]


def some_model(seed=0) -> DynamicModel:
    """A model of the planar arm with every part that a model may have."""
    robot = Robot.load(MODELS / "planar.xml")
    effects = [cls((j,)) for cls in (Viscous, TorqueOffset) for j in range(2)]
    problem = build_problem(robot.chain, effects)
    rng = np.random.default_rng(seed)
    full = np.append(robot.chain.inertial.ravel(), rng.uniform(0.1, 1.0, 4))
    base, effects = problem.fitted(problem.base.mapping @ full)
    x, y = rng.normal(size=(300, 2)), rng.normal(size=(300, 1))
    regression = GaussianMixtureRegression.fit(x, y, components=1)
    plain = DynamicModel(robot, base, effects, None, 20.0, np.full(2, 0.01))
    return replace(
        plain,
        remainder=ArmRemainder(2, (JointRemainder(1, (1,), (1,), regression),)),
        range={"q_min": np.zeros(2), "q_max": np.ones(2), "v_max": np.ones(2)},
        inertial=robot.chain.inertial,
        simpler={"LS": plain},
    )


def some_motion() -> Motion:
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 50, 2))
    t = np.arange(50) / 100
    return Motion(t, q, v, a, np.full((50, 2), np.nan), np.ones(50, dtype=bool))


@pytest.fixture
def saved(tmp_path) -> Path:
    some_model().save(tmp_path / "model.json")
    return tmp_path / "model.json"


def refused(path: Path) -> str:
    """The one line with which a model is refused."""
    with pytest.raises(ModelFileError) as error:
        DynamicModel.load(path)
    text = str(error.value)
    assert text.startswith(str(path.parent)) and "\n" not in text
    return text


def rewrite(path: Path, change) -> None:
    """Change the arrays, with a hash that fits."""
    beside = path.with_suffix(".safetensors")
    arrays = {k: np.array(x) for k, x in load(beside.read_bytes()).items()}
    change(arrays)
    numbers = save({k: np.ascontiguousarray(x) for k, x in arrays.items()})
    beside.write_bytes(numbers)
    content = json.loads(path.read_text("utf-8"))
    content["arrays_sha256"] = hashlib.sha256(numbers).hexdigest()
    path.write_text(json.dumps(content), "utf-8")


def test_every_part_comes_back_and_predicts_the_same_to_the_last_bit(saved):
    model, again = some_model(), DynamicModel.load(saved)
    motion = some_motion()
    assert np.array_equal(model.predict(motion), again.predict(motion))
    assert again.effects == model.effects
    assert again.simpler.keys() == {"LS"} and again.simpler["LS"].inertial is None
    assert np.array_equal(again.inertial, model.inertial)
    assert again.stage == "+ consistent"
    for name, values in model.range.items():
        assert np.array_equal(again.range[name], values)


def test_consistent_links_give_the_torque_of_the_base_parameters():
    model, motion = some_model(), some_motion()
    plain = replace(model, inertial=None)
    tau = model.predict(motion)
    np.testing.assert_allclose(
        tau, plain.predict(motion), rtol=0, atol=1e-8 * np.abs(tau).max()
    )


def test_a_prediction_needs_no_torque():
    assert np.isfinite(some_model().predict(some_motion())).all()


def test_both_files_have_ordinary_permissions(saved):
    mask = os.umask(0)
    os.umask(mask)
    for path in (saved, saved.with_suffix(".safetensors")):
        assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


def test_a_crash_between_the_two_files_is_noticed(saved, monkeypatch):
    def crash(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(model_file, "write_json", crash)
    with pytest.raises(KeyboardInterrupt):
        some_model(seed=5).save(saved)
    assert "of another model than model.json" in refused(saved)


def test_arrays_of_another_model_are_noticed(saved, tmp_path):
    some_model(seed=5).save(tmp_path / "other.json")
    (tmp_path / "other.safetensors").replace(saved.with_suffix(".safetensors"))
    assert "of another model" in refused(saved)


def put(name, value):
    return lambda arrays: arrays.update({name: value})


DAMAGED_ARRAYS = {
    "mapping of another shape": (put("mapping", np.ones((3, 3))), "mapping has shape"),
    "a value is NaN": (lambda a: a["values"].fill(np.nan), "values has shape"),
    "a value is infinite": (lambda a: a["mapping"].fill(np.inf), "finite numbers"),
    "single precision": (
        lambda a: a.update(values=a["values"].astype(np.float32)),
        "float32",
    ),
    "no values": (lambda a: a.pop("values"), "not a saved model"),
    "inertial of one link": (put("inertial", np.ones((1, 10))), "inertial has shape"),
    "two cut-offs": (put("cutoff", np.ones(2)), "cutoff is"),
    "a negative cut-off": (put("cutoff", np.array([-1.0])), "cutoff is"),
    "a range of three joints": (put("range.q_min", np.ones(3)), "range.q_min has"),
    "a mixture without means": (
        lambda a: a.pop("remainder.0.means"),
        "mixture has arrays",
    ),
    "no simpler values": (lambda a: a.pop("LS/values"), "not a saved model"),
}


@pytest.mark.parametrize("name", DAMAGED_ARRAYS)
def test_damaged_arrays_are_refused(saved, name):
    change, words = DAMAGED_ARRAYS[name]
    rewrite(saved, change)
    assert words in refused(saved)


def change_json(path: Path, keys, value) -> None:
    content = json.loads(path.read_text("utf-8"))
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    path.write_text(json.dumps(content), "utf-8")


DAMAGED_JSON = [
    (("schema",), "hybrid.model/0", f"valid is {SCHEMA}"),
    (("base", "kept"), [0, 1, 10_000], "kept parameters"),
    (("base", "kept"), [-1], "kept parameters"),
    (("base", "labels"), ["m_1"], "labels"),
    (("base",), [], "not a saved model"),
    (("simpler",), 3, "not a saved model"),
    (("effects", 0, "joints"), ["wrist"], "wrist"),
    (("effects", 0, "effect"), "antigravity", "antigravity"),
    (("effects", 0, "values"), {"damping": 1.0}, "no parameter damping"),
    (("effects", 0, "std"), {"coefficient": "wide"}, "std"),
    (("remainder", 0, "joint"), 7, "joint 7"),
    (("remainder", 0, "kind"), "oracle", "remainder 0"),
    (("robot",), {}, "not a saved robot"),
    (("robot", "chain", "axis"), [[0, 0, 1]], "axis has shape"),
    (("robot", "chain", "inertial", 0, 0), None, "inertial"),
    (("robot", "chain", "joints"), ["elbow", "elbow"], "elbow"),
    (("robot", "tau_max"), [1.0], "tau_max needs one value"),
    (("arrays_sha256",), None, "of another model"),
]


@pytest.mark.parametrize(("keys", "value", "words"), DAMAGED_JSON)
def test_damaged_descriptions_are_refused(saved, keys, value, words):
    change_json(saved, keys, value)
    assert words in refused(saved)


def places(content, path=()):
    """Every place in a JSON document that holds something."""
    items = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


JUNK = st.sampled_from([None, -1, 1e9, "x", [], {}, [[1]], True])


@settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data(), junk=JUNK)
def test_whatever_is_damaged_the_error_is_that_of_a_damaged_file(
    saved, tmp_path, data, junk
):
    content = json.loads(saved.read_text("utf-8"))
    keys = data.draw(st.sampled_from(sorted(places(content), key=str)))
    broken = tmp_path / "broken.json"
    broken.write_text(saved.read_text("utf-8"), "utf-8")
    change_json(broken, keys, junk)
    try:
        DynamicModel.load(broken)
    except ModelFileError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("text", ["", "[]", "null", "{", '{"schema": 1}', "\xff"])
def test_a_file_of_something_else_is_refused(saved, text):
    saved.write_bytes(text.encode("latin-1"))
    refused(saved)


def test_a_missing_file_is_named(saved):
    saved.with_suffix(".safetensors").unlink()
    assert "model.safetensors: missing" in refused(saved)
    saved.unlink()
    assert "cannot be read" in refused(saved)


def test_a_robot_without_sense_is_refused():
    content = Robot.load(MODELS / "planar.xml").as_dict()
    for change in (
        {"chain": content["chain"] | {"gravity": [0.0, 0.0]}},
        {"chain": content["chain"] | {"axis": [[0.0, 0.0, None]] * 2}},
        {"chain": []},
        {"q_min": {}},
    ):
        with pytest.raises(RobotError):
            Robot.from_dict(content | change)
