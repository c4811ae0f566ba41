"""Saved models: equal when read back, and refused in one line when damaged."""

import json
import os
import stat
import sys
from base64 import b64encode
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arms import MODELS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.effects import Scale
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import ModelFileError, RobotError
from hybrid.identification import DynamicModel
from hybrid.model.model_file import SCHEMA
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

model_file = sys.modules["hybrid.model.model_file"]


@cache
def some_model() -> DynamicModel:
    """A model of the planar arm with every part that a model may have."""
    robot = Robot.load(MODELS / "planar.xml")
    effects = [cls((j,)) for cls in (Viscous, TorqueOffset) for j in range(2)]
    problem = build_problem(robot.chain, effects)
    rng = np.random.default_rng(0)
    full = np.append(robot.chain.inertial.ravel(), rng.uniform(0.1, 1.0, 4))
    base, effects = problem.fitted(problem.base.mapping @ full)
    x, y = rng.normal(size=(300, 2)), rng.normal(size=(300, 1))
    regression = fit_gmr(x, y, components=1)
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


@pytest.fixture(scope="module")
def model_text(tmp_path_factory) -> str:
    """A saved model."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    some_model().save(path)
    return path.read_text("utf-8")


@pytest.fixture
def saved(tmp_path, model_text) -> Path:
    (tmp_path / "model.json").write_text(model_text, "utf-8")
    return tmp_path / "model.json"


def refused(path: Path) -> str:
    """The one line with which a model is refused."""
    with pytest.raises(ModelFileError) as error:
        DynamicModel.load(path)
    text = str(error.value)
    assert text.startswith(str(path.parent)) and "\n" not in text
    return text


def seal(path: Path, content) -> None:
    """Write content with a hash that fits, as one would who means harm."""
    if isinstance(content, dict) and "sha256" in content:
        rest = {k: x for k, x in content.items() if k != "sha256"}
        content["sha256"] = model_file.content_digest(rest)
    path.write_text(json.dumps(content), "utf-8")


def change_json(path: Path, keys, value) -> None:
    content = json.loads(path.read_text("utf-8"))
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value(at[keys[-1]]) if callable(value) else value
    seal(path, content)


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


def test_the_file_has_ordinary_permissions(saved):
    saved.unlink()
    some_model().save(saved)
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(saved.stat().st_mode) == 0o666 & ~mask


def test_a_model_that_could_not_be_read_again_is_not_saved(tmp_path):
    model = replace(some_model(), standing=np.full(2, np.nan), simpler={})
    with pytest.raises(ModelFileError, match="not saved, .*not JSON"):
        model.save(tmp_path / "model.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("effects", 0, "values", "coefficient"), lambda x: 5 * x),
        (("robot", "chain", "gravity"), [0.0, 0.0, 0.0]),
        (("base", "values", 0), lambda x: np.nextafter(x, 9.0)),
        (("version",), "9.9"),
        (("simpler", "LS", "effects"), []),
    ],
)
def test_one_changed_value_is_noticed(saved, keys, value):
    content = json.loads(saved.read_text("utf-8"))
    before = content["sha256"]
    change_json(saved, keys, value)
    content = json.loads(saved.read_text("utf-8"))
    content["sha256"] = before
    saved.write_text(json.dumps(content), "utf-8")
    assert "its sha256 is not that of its content" in refused(saved)


def test_a_file_that_is_laid_out_anew_is_the_same_model(saved):
    content = json.loads(saved.read_text("utf-8"))
    saved.write_text(json.dumps(content, sort_keys=True), "utf-8")
    assert DynamicModel.load(saved).stage == "+ consistent"


def packed(values, shape) -> dict:
    data = b64encode(np.array(values, dtype="<f8").tobytes()).decode()
    return {"shape": list(shape), "float64": data}


def twice(x):
    return (2 * np.array(x)).tolist()


MEANS = ("remainder", "arrays", "remainder.0.means")
DAMAGED_JSON = [
    (("schema",), "hybrid.model/0", f"valid is {SCHEMA}"),
    (("base", "mapping"), packed(np.ones(9), (3, 3)), "mapping has shape"),
    (("base", "mapping"), packed([np.inf] * 9, (3, 3)), "NaN or infinity"),
    (("base", "mapping", "shape"), [10**9, 10**9], "bytes for shape"),
    (("base", "mapping", "shape"), [-1, -1], "bytes for shape"),
    (("base", "mapping", "float64"), "!", "not a saved model"),
    (("base", "values"), [1.0], "values has shape"),
    (("base", "values", 0), "1.0", "valid are numbers"),
    (("base", "kept"), [0, 1, 10_000], "kept parameters"),
    (("base", "kept"), [-1], "kept parameters"),
    (("base", "labels"), ["m_1"], "labels"),
    (("base",), [], "not a saved model"),
    (("cutoff",), -1.0, "cutoff is"),
    (("cutoff",), True, "is no number"),
    (("standing", 0), -0.1, "standing is -0.1"),
    (("inertial",), [[1.0] * 10], "inertial has shape"),
    (("range", "q_min"), [1.0, 1.0, 1.0], "range.q_min has"),
    (("range", "q_min"), [2.0, 2.0], "above range.q_max"),
    (("simpler",), 3, "not a saved model"),
    (("simpler", "LS", "base", "values"), [], "values has shape"),
    (("effects", 0, "joints"), ["wrist"], "wrist"),
    (("effects", 0, "effect"), "antigravity", "antigravity"),
    (("effects", 0, "values"), {"damping": 1.0}, "no parameter damping"),
    (("effects", 0, "values", "coefficient"), 1e9, "valid is up to"),
    (("effects", 0, "values", "coefficient"), "1.0", "is no number"),
    (("effects", 0, "std"), {"coefficient": "wide"}, "is no number"),
    (("effects", 0, "std"), {"coefficient": -1.0}, "std"),
    (("remainder", "parts", 0, "joint"), 7, "joint 7"),
    (("remainder", "parts", 0, "kind"), "oracle", "remainder 0"),
    (("remainder", "parts"), lambda x: x + x, "mixture has arrays"),
    (("remainder", "arrays"), {}, "mixture has arrays"),
    (MEANS, packed([1.0], (1, 1)), "means has shape"),
    (("robot",), {}, "not a saved robot"),
    (("robot", "name"), "a\x1b[31m", "printable"),
    (("robot", "chain", "axis"), [[0, 0, 1]], "axis has shape"),
    (("robot", "chain", "axis", 1), [0.0, 0.0, 0.0], "'elbow' is not of length 1"),
    (("robot", "chain", "rotation"), twice, "'shoulder' is not orthonormal"),
    (("robot", "chain", "rotation", 0), (-np.eye(3)).tolist(), "not right-handed"),
    (("robot", "chain", "revolute"), ["no", "no"], "valid are true and false"),
    (("robot", "chain", "revolute"), [1, 1], "valid are true and false"),
    (("robot", "chain", "revolute", 0), False, "of another arm"),
    (("robot", "chain", "gravity"), [0.0, 0.0, -1e9], "gravity is"),
    (("robot", "chain", "translation"), twice, "of another arm"),
    (("robot", "chain", "inertial", 0, 0), None, "inertial"),
    (("robot", "chain", "joints"), ["elbow", "elbow"], "elbow"),
    (("robot", "chain", "joints", 0), "a\nb", "joint name 'a\\nb'"),
    (("robot", "tau_max"), [1.0], "tau_max needs one value"),
    (("robot", "q_min"), [9.0, 9.0], "above its q_max"),
    (("robot", "kp"), ["1", "2"], "kp holds more than numbers"),
    (("fingerprint",), "0123456789abcdef", "of another arm"),
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
    max_examples=60,
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
    if keys == ("sha256",):
        content["sha256"] = junk
        broken.write_text(json.dumps(content), "utf-8")
    try:
        DynamicModel.load(broken)
    except ModelFileError as error:
        assert "\n" not in str(error)


HOSTILE = ["", "[]", "null", "{", '{"schema": 1}', "\xff", "[" * 100_000]
HOSTILE += ['{"schema": NaN}', "[" * 900 + "]" * 900, '{"a": 1' + "0" * 9999 + "}"]


@pytest.mark.parametrize("text", HOSTILE)
def test_a_file_of_something_else_is_refused(saved, text):
    saved.write_bytes(text.encode("latin-1"))
    refused(saved)


def test_a_file_beyond_all_measure_is_refused_before_it_is_read(saved):
    with saved.open("r+b") as file:
        file.truncate(2**40)
    assert "valid are up to" in refused(saved)


def test_a_missing_file_is_named(saved):
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


def test_an_array_of_one_number_comes_back():
    text = model_file._packed(np.array(1.5))
    assert model_file._unpacked("x", text) == np.array(1.5)


def test_an_arm_has_ten_parameters_of_each_link_and_more(saved):
    base = json.loads(saved.read_text("utf-8"))["base"]
    for count in (19, 20):
        content = base | {
            "labels": base["labels"][:count],
            "units": base["units"][:count],
            "kept": list(range(count)),
            "mapping": packed(np.eye(count), (count, count)),
            "values": [1.0] * count,
        }
        robot = some_model().robot
        if count == 20:
            assert model_file._base(robot, content).size == 20
            continue
        with pytest.raises(ModelFileError, match="have 19 labels and 19 units"):
            model_file._base(robot, content)


def test_a_slow_log_may_show_more_friction_than_fast_joints_have(tmp_path):
    """A robot file often states a speed that the arm never has."""
    robot = replace(some_model().robot, v_max=np.full(2, 10.0))
    drag = NonlinearViscous((0,), {"cubic": 1000 * robot.tau_max[0] / 10.0**3})
    slow = replace(
        some_model(), robot=robot, effects=(drag,), simpler={}, remainder=None
    )
    path = tmp_path / "model.json"
    with pytest.raises(ModelFileError, match="not saved, nonlinear_viscous: cubic is"):
        replace(slow, range={}).save(path)
    slow.save(path)
    assert DynamicModel.load(path).effects == (drag,)


@pytest.mark.parametrize("share", [0.9995, 1.0005])
def test_a_parameter_is_within_a_thousand_times_its_largest_plausible_value(
    saved, share
):
    model = some_model()
    scale = joint_scales(model.robot)[0]
    scale = Scale(max(scale.torque, 1.0), 1.0)  # 1 rad/s is the fastest seen
    most = 1000.0 * Viscous.gains[0].scaled(scale).upper
    keys = ("effects", 0, "values", "coefficient")
    change_json(saved, keys, share * most)
    if share > 1.0:
        assert f"valid is up to {most:g}" in refused(saved)
    else:
        loaded = DynamicModel.load(saved).effects[0]
        assert loaded.values["coefficient"] == pytest.approx(share * most)
