"""Parts of a map of columns: sources, factors, presets, and what is refused."""

import numpy as np
import pytest

from hybrid.errors import RecordingError
from hybrid.recording.labels import parse_label
from hybrid.recording.mapping import Mapping, Source, preset_of, read_mapping
from hybrid.recording.read import recording_from_table


def test_a_source_keeps_its_own_columns_unit_and_factors():
    above = Source("q{}", "", {"scale": 2.0}, dropped=True)
    below = Source("x{}", "deg", {"scale": 3.0, "ratio": 4.0})
    assert above.over(below) == Source("q{}", "deg", {"scale": 2.0, "ratio": 4.0}, True)
    assert Source(None, "rad").over(below).columns == "x{}"
    assert Source(None, "rad").over(below).unit == "rad"


def test_columns_are_found_by_pattern_with_or_without_their_unit():
    labels = ["t", "q_a [deg]", "q_b", "q_", "xq_c", "tau"]
    assert Source("q_{}").found(labels) == {1: "a", 2: "b"}
    assert Source("q_{} [deg]").found(labels) == {1: "a"}
    assert Source("tau").found(labels) == {5: "1"}
    assert Source("{}u").found(labels) == {5: "ta"}
    assert Source(None).found(labels) == {}
    assert Source({"a": "tau", "b": "q_b"}).found(labels) == {5: "a", 2: "b"}
    table = {"t": np.arange(9.0), "tau_a": np.ones(9), "q_a [deg]": np.full(9, 90.0)}
    log = recording_from_table(table, joints=("a",), map={"q": "q_{}"})
    np.testing.assert_allclose(log.q, np.pi / 2)
    with pytest.raises(ValueError, match="no column 'nothing'"):
        Source({"a": "nothing"}).found(labels)


def test_factors_of_a_joint_multiply():
    source = Source(
        factors={"ratio": 10.0, "constant": (2.0, 3.0), "scale": {"b": 0.5}}
    )
    assert source.factor("ab", 1) == 15.0
    with pytest.raises(RecordingError, match="no scale for a"):
        source.factor("ab", 0)
    for joints in ("b", "bcd"):
        with pytest.raises(RecordingError, match="2 numbers as constant for"):
            source.factor(joints, 0)
    assert Source().factor("a", 0) == 1.0


@pytest.mark.parametrize("value", [None, False, "none"])
def test_a_channel_of_none_is_dropped(value):
    made = read_mapping({"v": value, "q": "x{}"})
    assert made.source("v") == Source(dropped=True)
    assert made.source("q") == Source("x{}") and not made.source("tau").dropped


def test_a_map_is_read_in_every_form():
    made = read_mapping({
        "joints": {"m1": "a", "m2": "b"}, "topic": "/arm",
        "q": ["x", "y"], "v": {"columns": {"a": "va"}, "unit": "deg/s"},
        "tau": {"column": "i{}", "unit": "A", "torque_constant": [0.1, 0.2]},
    })  # fmt: skip
    assert made.joints == () and made.names == {"m1": "a", "m2": "b"}
    assert made.topic == "/arm" and made.source("q") == Source({"1": "x", "2": "y"})
    assert made.source("v") == Source({"a": "va"}, "deg/s")
    factors = {"torque_constant": (0.1, 0.2)}
    assert made.source("tau") == Source("i{}", "A", factors)
    listed = read_mapping({"joints": ["a", "b"], "time": {"rate": 100}})
    assert listed.joints == ("a", "b") and listed.names == {}
    assert listed.source("time").factors == {"rate": 100.0}
    assert read_mapping(None) == Mapping() and read_mapping(listed) is listed


def test_a_preset_is_known_by_its_name_or_by_the_labels_of_a_log():
    assert preset_of(("timestamp", "actual_q_0", "target_q_0")).preset == "ur_rtde"
    assert preset_of(("timestamp", "actual_q_0")) == Mapping()
    assert preset_of((), "plotjuggler").preset == "plotjuggler"
    assert preset_of(("__time", "x")).preset == "plotjuggler"
    assert preset_of(("x",)) == Mapping()
    assert read_mapping("ur_driver") == Mapping("ur_driver", origin="ur_driver")
    assert preset_of((), "ur_driver").source("tau").unit == "A"


def test_a_map_is_above_its_preset_channel_by_channel():
    table = {"t": np.arange(9.0), "position_a": np.full(9, 90.0)}
    table["velocity_a"] = np.ones(9)
    own = {"preset": "ur_driver", "q": {"unit": "deg"}}
    log = recording_from_table(table, joints=("a",), map=own, torque=False)
    np.testing.assert_allclose(log.q, np.pi / 2)
    units = {u.channel: (u.unit, u.stated) for u in log.reading.columns}
    assert units["q"] == ("deg", True) and units["v"] == ("rad/s", True)
    assert log.reading.preset == "ur_driver"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"qq": 1, "x": 2}, "unknown 'qq', 'x'"), ([1], r"is \[1\], not a table"),
        (None, "map: is empty, not a table"), ({"joints": ["a", "a"]}, "each once"),
        ({"joints": {"m": ["a"]}}, "joints is {'m'"),
        ({"preset": "mine"}, "preset 'mine'; valid are ur_rtde"),
        ({"joints": 3}, "joints is 3"),
        ({"q": {"unit": "kg"}}, "unit 'kg' is none of rad or m"),
        ({"tau": {"unit": "deg"}}, "unit 'deg' is none of"),
        ({"q": 5}, "q is 5; valid are a label"),
        ({"q": {"a": 5}}, "q is .*; valid are a label"),
        ({"time": {"rate": 0}}, "valid is a rate above 0"),
        ({"time": {"rate": [1]}}, "valid is a rate above 0"),
        ({"q": {"rate": 100}}, "valid is a rate above 0"),
        ({"time": {"torque_constant": 2}}, "valid is a rate above 0"),
        ({"tau": {"torque_constant": "x"}}, "is 'x'; valid are numbers"),
        ({"tau": {"torque_constant": float("inf")}}, "valid are numbers"),
    ],
)  # fmt: skip
def test_what_is_no_map_is_refused(content, words):
    if not isinstance(content, dict):
        from hybrid.recording.mapping import _mapping

        with pytest.raises(RecordingError, match=words):
            _mapping(content, "map")
        return
    with pytest.raises(RecordingError, match=words):
        read_mapping(content)


@pytest.mark.parametrize(
    ("label", "channel"),
    [
        ("q_d_1", "command"),
        ("d_q_1", "q"),
        ("arm_d_q_1", "q"),
        ("qd_1", "v"),
        ("d", ""),
    ],
)
def test_a_d_behind_a_quantity_is_a_desired_one_and_a_name_elsewhere(label, channel):
    assert parse_label(label).channel == channel
