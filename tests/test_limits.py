"""Files and numbers at a limit are taken, and those just beyond it are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.errors import HybridWarning, ModelFileError, RecordingError, RobotError
from hybrid.model import DynamicModel
from hybrid.model.model_file import content_digest
from hybrid.recording import Recording
from hybrid.recording.assignment import Assignment
from hybrid.recording.clock import resample, unbroken
from hybrid.recording.labels import parse_label, split_unit
from hybrid.recording.mapping import Mapping
from hybrid.recording.table import LogTable
from hybrid.regression.problem import build_problem
from hybrid.robot.chain import Chain
from hybrid.robot.demand import _product, check_demand

# --- robot files ----------------------------------------------------------------------


def demanded(tmp_path, text):
    path = tmp_path / "arm.xml"
    path.write_text(text)
    check_demand(path)


def nested(depth):
    return "<a>" * depth + "</a>" * depth


@pytest.mark.parametrize(
    ("make", "most", "word"),
    [
        (lambda k: "<a/>" * k, 8000, "elements"),
        (lambda k: f"<replicate count='{k}'><a/></replicate>", 4000, "elements"),
        (lambda k: f"<flexcomp count='{k} 2 1'/>", 4000, "elements"),
        (nested, 300, "levels"),
        (lambda k: f"<texture width='{k}' height='3'/>", 10_000_000, "numbers"),
        (lambda k: f"<numeric size='{k}'/>", 30_000_000, "numbers"),
        (lambda k: f"<size nuserdata='{k}'/>", 30_000_000, "numbers"),
        (lambda k: f"<size nkey='{k}'/>", 10_000, "nkey"),
        (lambda k: f"<size nconmax='{k}'/>", 1_000_000, "nconmax"),
        (lambda k: f"<size njmax='{k}'/>", 1_000_000, "njmax"),
        (lambda k: f"<size nstack='{k}'/>", 1_000_000_000, "nstack"),
        (lambda k: f"<size memory='{k}'/>", 2**34, "memory"),
    ],
)
def test_a_robot_file_may_ask_for_so_much_and_no_more(tmp_path, make, most, word):
    demanded(tmp_path, make(most))
    with pytest.raises(RobotError, match=rf"{word}.* valid (is|are) up to"):
        demanded(tmp_path, make(most + 1))


def test_sizes_have_the_prefixes_of_bytes():
    for k, prefix in enumerate("KMGTPE", 1):
        assert (
            _product(f"3{prefix}")
            == _product(f"3{prefix.lower()}")
            == 3 * 2.0 ** (10 * k)
        )
    assert _product("-4") == 4.0 and _product("") == 1.0 and _product("K") == 1.0


def test_a_file_is_included_with_ninety_nine_others(tmp_path):
    for k in range(1, 101):
        name = f"part{k + 1}.xml"
        (tmp_path / f"part{k}.xml").write_text(f"<a><include file='{name}'/></a>")
    demanded(tmp_path, "<a><include file='part2.xml'/></a>")
    with pytest.raises(RobotError, match="asks for 101 files"):
        demanded(tmp_path, "<a><include file='part1.xml'/></a>")


def test_a_file_and_what_it_names_may_be_large(tmp_path):
    for name, size in (("small", 2**29), ("large", 2**29 + 1)):
        with (tmp_path / f"{name}.stl").open("wb") as file:
            file.truncate(size)
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "small.stl").hardlink_to(tmp_path / "small.stl")
    both = "<compiler meshdir='sub'/><mesh file='small.stl'/>"
    demanded(tmp_path, both)
    with pytest.raises(RobotError, match="bytes of its files"):
        demanded(tmp_path, both + "<mesh file='large.stl'/>")
    (tmp_path / "dir").mkdir()
    demanded(tmp_path, "<mesh file='dir'/>")


@pytest.mark.parametrize(("beyond", "valid"), [(0.9e-6, True), (1.1e-6, False)])
def test_rotations_and_axes_may_be_rounded_to_six_digits(beyond, valid):
    chain = pendulum(2).chain
    turned = chain.rotation.copy()
    turned[1, 0, 0] = np.sqrt(1 + beyond)
    long = chain.axis.copy()
    long[1] *= 1 + beyond
    for change, words in (
        ({"rotation": turned}, "rotation of joint 'hinge_1' is not orthonormal"),
        ({"axis": long}, "axis of joint 'hinge_1' is not of length 1"),
    ):
        if valid:
            assert isinstance(replace(chain, **change), Chain)
            continue
        with pytest.raises(RobotError, match=words):
            replace(chain, **change)


def test_gravity_is_up_to_a_hundred_times_that_of_the_earth():
    chain = pendulum(1).chain
    replace(chain, gravity=np.array([0.0, 600.0, -800.0]))
    with pytest.raises(RobotError, match="valid is up to 1000"):
        replace(chain, gravity=np.array([0.0, 600.0, -801.0]))
    mirrored = np.diag([1.0, 1.0, -1.0])[None]
    with pytest.raises(RobotError, match="is not right-handed"):
        replace(chain, rotation=mirrored)
    with pytest.raises(RobotError, match="more than True and False"):
        replace(chain, revolute=np.ones(1))


# --- clocks ---------------------------------------------------------------------------


def recording(t):
    q = np.sin(t)[:, None]
    return Recording(t, q, tau=q)


@pytest.mark.parametrize(("share", "same"), [(0.0099, True), (0.0101, False)])
def test_a_clock_may_be_off_by_a_hundredth_of_its_step(share, same):
    t = 0.01 * np.arange(200.0)
    t[50] += 0.01 * share
    if same:
        found = resample(log := recording(t))
        assert found is log
        return
    with pytest.warns(
        HybridWarning, match=r"2 of 199 steps .* to 200 samples at 100 Hz"
    ):
        found = resample(recording(t))
    np.testing.assert_allclose(np.diff(found.t), 0.01)


@pytest.mark.parametrize(("steps", "kept"), [(10, True), (10.01, False)])
def test_a_gap_of_ten_steps_is_bridged_and_a_longer_one_splits(steps, kept):
    t = 0.015625 * np.arange(200.0)
    t[100:] += 0.015625 * (steps - 1)
    log = recording(t)
    if kept:
        assert unbroken(log) == (log,)
        with pytest.warns(HybridWarning, match="irregular clock: 1 of 199"):
            assert len(resample(log).t) == 209
        return
    with pytest.raises(RecordingError, match="valid are gaps up to 10 steps"):
        resample(log)
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        first, second = unbroken(log)
    assert len(first.t) == len(second.t) == 100 and second.t[0] == t[100]


def test_a_part_of_a_second_is_kept_and_a_shorter_one_is_left_out():
    step = 2.0**-6
    t = step * np.arange(65 + 64 + 100.0)
    t[65:] += 1.0
    t[129:] += 1.0
    with pytest.warns(HybridWarning, match=r"taken as 2 .* without 3.02 s of gaps"):
        parts = unbroken(recording(t))
    assert [len(x.t) for x in parts] == [65, 100]


# --- labels ---------------------------------------------------------------------------


def test_a_label_of_three_hundred_characters_is_parsed_and_no_longer_one():
    at, beyond = ("a" * count + "_q1" for count in (297, 298))
    assert parse_label(at).channel == "q"
    assert parse_label(beyond).why == "a label of more than 300 characters"
    unit = "_deg"
    long = "a" * 293 + "_q1"
    assert split_unit(long + unit) == (long, "deg")
    assert split_unit("a" + long + unit) == ("a" + long + unit, "")


def test_a_table_has_twenty_thousand_columns_at_most():
    plain = Mapping()
    Assignment(LogTable("x", ("t",) * 20_000, dict), None, plain, False)
    with pytest.raises(RecordingError, match="20001 columns; valid are up to 20000"):
        Assignment(LogTable("x", ("t",) * 20_001, dict), None, plain, False)


# --- saved models ---------------------------------------------------------------------


def saved(path, change):
    """A saved model with other content, and its right hash."""
    robot = replace(pendulum(1), tau_max=np.full(1, 50.0))
    problem = build_problem(robot.chain, [])
    effects = Coulomb((0,), {"level": 1.0}), TorqueOffset((0,), {"level": 2.0})
    DynamicModel(robot, problem.base.with_values(np.ones(problem.size)), effects).save(
        path
    )
    content = json.loads(path.read_text())
    change(content)
    del content["sha256"]
    path.write_text(json.dumps({"sha256": content_digest(content), **content}))
    return DynamicModel.load(path)


def effect(k, values):
    return lambda content: content["effects"][k]["values"].update(values)


def test_a_parameter_is_up_to_a_thousand_times_its_largest_plausible_size(tmp_path):
    path = tmp_path / "model.json"
    for k, most in ((0, 0.3 * 50.0 * 1e3), (1, 0.3 * 50.0 * 1e3)):
        for x in (most, -most):
            found = saved(path, effect(k, {"level": x}))
            assert found.effects[k].values["level"] == x
        with pytest.raises(ModelFileError, match=f"valid is up to {most:g}"):
            saved(path, effect(k, {"level": 1.001 * most}))


def put(*keys, value):
    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("base", "kept", value=[0, 0]), "kept parameters are not different ones"),
        (put("base", "kept", value=[-1]), "kept parameters are not different ones"),
        (put("base", "kept", value=[10]), "kept parameters are not different ones"),
        (put("base", "units", value=["kg"]), "10 labels and 1 units"),
        (lambda c: [c["base"][x].pop() for x in ("labels", "units")], "9 labels and 9"),
        (put("base", "kept", value=[True]), "True is no whole number"),
        (put("cutoff", value=0.0), "cutoff is 0"),
        (put("cutoff", value=True), "True is no number"),
        (put("standing", value=[-0.1]), "standing is -0.1; valid is 0 or more"),
        (put("standing", value=[0.1, 0.1]), "standing has shape"),
        (put("range", value={"q_min": [1.0], "q_max": [0.0]}), "q_min is above"),
        (put("range", value={"v_max": [-1.0]}), "range.v_max is -1"),
        (put("logs", value=["a", 3]), "logs is no list of hashes"),
        (put("logs", value="abc"), "logs is no list of hashes"),
        (put("inertial", value=[[1.0] * 9]), "inertial has shape"),
        (put("inertial", value=[["1"] * 10]), "valid are numbers"),
        (put("covariance", value={"shape": [-1, -1], "float64": "AAAAAAAA8D8="}),
         "for shape"),
        (put("covariance", value={"shape": [1, 1], "float64": "AAAAAAAA8D8="}),
         "covariance has shape"),
        (put("schema", value="hybrid.model/1"), "schema is 'hybrid.model/1', valid is"),
        (put("fingerprint", value="0"), "it is of another arm"),
        (lambda c: c["effects"][0]["std"].update(level=-1.0), "coulomb: std is"),
    ],
)  # fmt: skip
def test_numbers_that_no_saved_model_has_are_refused(tmp_path, change, words):
    with pytest.raises(ModelFileError, match=words):
        saved(tmp_path / "model.json", change)


@pytest.mark.parametrize(
    "change",
    [
        put("cutoff", value=1e-9), put("cutoff", value=None), put("cutoff", value=3),
        put("standing", value=[0.0]), put("standing", value=[]),
        put("range", value={"q_min": [0.0], "q_max": [0.0], "v_max": [0.0]}),
        put("range", value={"q_min": [-3.0]}), put("logs", value=[]),
        lambda c: c.pop("logs"), lambda c: c["effects"][0]["std"].update(level=0.0),
    ],
)  # fmt: skip
def test_numbers_that_a_saved_model_may_have_are_read(tmp_path, change):
    model = saved(tmp_path / "model.json", change)
    assert [e.values["level"] for e in model.effects] == [1.0, 2.0]
