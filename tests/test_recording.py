"""A recording holds one log on one clock, or says in one line why it cannot."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.errors import HybridWarning, RecordingError
from hybrid.files import atomic_path, write_json
from hybrid.recording import (
    Recording,
    read,
    recording_from_table,
    resample,
    unbroken,
)
from hybrid.recording.joints import _prefix


def log(samples: int = 200, joints: int = 3, rate: float = 100.0) -> Recording:
    rng = np.random.default_rng(0)
    t = np.arange(samples) / rate
    q = np.sin(np.outer(t, np.arange(1, joints + 1)))
    return Recording(
        t=t, q=q, tau=rng.standard_normal(q.shape), source="log.csv", v=np.cos(q)
    )


def test_size_rate_and_duration_follow_from_the_arrays():
    recording = log(samples=201, joints=3, rate=100.0)
    assert recording.size == 3
    assert recording.rate == pytest.approx(100.0)
    assert recording.duration == pytest.approx(2.0)
    assert set(recording.channels) == {"q", "tau", "v"}


def test_joints_without_names_are_numbered_from_one():
    assert log().joints == ("joint_1", "joint_2", "joint_3")


def test_integers_and_lists_become_arrays_of_floats():
    recording = Recording(t=[0, 1], q=[[0], [1]], tau=[[2], [3]])  # type: ignore[arg-type]
    assert recording.q.dtype == np.float64
    assert recording.tau.shape == (2, 1)


def test_recordings_are_equal_by_content_whatever_their_source():
    one, other = log(), log()
    assert one == other
    assert one != Recording(t=other.t, q=other.q, tau=other.tau)
    assert one != Recording(t=other.t, q=other.q + 1e-15, tau=other.tau, v=other.v)
    assert one != "log.csv"


def test_columns_move_with_their_names_when_joints_are_reordered():
    recording = Recording(**vars(log()) | {"joints": ("shoulder", "elbow", "wrist")})
    turned = recording.in_order(("wrist", "shoulder", "elbow"))
    assert np.array_equal(turned.q[:, 0], recording.q[:, 2])
    assert np.array_equal(turned.v[:, 2], recording.v[:, 1])
    assert turned.in_order(recording.joints) == recording


def test_numbered_joints_take_the_names_they_are_given():
    assert log().in_order(("a", "b", "c")).joints == ("a", "b", "c")
    with pytest.raises(RecordingError, match="log.csv: 3 joints; valid are 2: a, b"):
        log().in_order(("a", "b"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(5)}, r"q has shape \(5,\); valid is \(N, n\)"),
        ({"tau": np.zeros((200, 2))}, r"tau has shape \(200, 2\); valid is \(200, 3\)"),
        ({"t": np.zeros(1)}, "two rows or more"),
        ({"t": np.zeros((200, 1))}, "one column"),
        ({"joints": ("a", "b")}, "joints are a, b; valid are 3 names"),
        ({"joints": ("a", "b", "a")}, "all different"),
        ({"q": [["x"]]}, "q is not an array of numbers"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_by_name(change, message):
    with pytest.raises(RecordingError, match=f"^log.csv: {message}|{message}"):
        Recording(**vars(log()) | change)


@pytest.mark.parametrize("channel", ["q", "tau", "v", "command", "temperature"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_sample_that_is_not_finite_is_named_by_channel_joint_and_row(channel, value):
    x = np.zeros((200, 3))
    x[16, 1] = value
    fields = vars(log()) | {"joints": ("base", "elbow", "wrist"), channel: x}
    place = rf"log.csv: {channel}2 \(elbow\), row 17 \(data rows count from 1\)"
    with pytest.raises(RecordingError, match=place):
        Recording(**fields)


def test_a_joint_without_a_number_is_told_apart_from_rows_without_one():
    tau = np.zeros((200, 3))
    tau[:, 1] = np.nan
    fields = vars(log()) | {"joints": ("base", "elbow", "wrist"), "tau": tau}
    with pytest.raises(RecordingError, match=r"tau2 \(elbow\): no number .* --joints$"):
        Recording(**fields)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.09, r"t, row 11 .*time 0.09 s is repeated"),
        (0.05, r"t, row 11 .*goes back from 0.09"),
        (np.nan, r"t, row 11 .*nan is not a finite number.*leave out such rows"),
    ],
)
def test_time_that_does_not_increase_is_named_by_row(value, message):
    t = np.arange(200) / 100
    t[10] = value
    with pytest.raises(RecordingError, match=message):
        Recording(**vars(log()) | {"t": t})


def test_a_uniform_clock_is_left_alone():
    recording = log()
    assert resample(recording) is recording


def test_time_rounded_to_a_thousandth_of_a_step_still_counts_as_uniform():
    recording = Recording(**vars(log()) | {"t": np.round(log().t * 1.00371, 5)})
    assert resample(recording) is recording


@settings(max_examples=25)
@given(seed=st.integers(0, 2**16), jitter=st.floats(0.05, 0.4))
def test_a_jittering_clock_is_resampled_onto_the_same_motion(seed, jitter):
    rng = np.random.default_rng(seed)
    t = (np.arange(500) + rng.uniform(-jitter, jitter, 500)) / 250
    recording = Recording(t=t, q=np.sin(3 * t)[:, None], tau=np.cos(3 * t)[:, None])
    with pytest.warns(HybridWarning, match="irregular clock: .* of 499 steps"):
        uniform = resample(recording)
    steps = np.diff(uniform.t)
    assert np.ptp(steps) < 1e-9
    assert uniform.t[0] == t[0]
    assert uniform.t[-1] <= t[-1] + 1e-12
    assert np.allclose(uniform.q[:, 0], np.sin(3 * uniform.t), atol=1e-4)
    assert np.allclose(uniform.tau[:, 0], np.cos(3 * uniform.t), atol=3e-4)


def test_dropped_samples_are_filled_on_the_clock_of_the_others():
    full = log(samples=400)
    kept = np.delete(np.arange(400), [57, 58, 200])
    channels = {name: x[kept] for name, x in full.channels.items()}
    with pytest.warns(HybridWarning, match="2 of 396 steps .* resampled to 400"):
        filled = resample(Recording(t=full.t[kept], **channels))
    assert np.allclose(filled.t, full.t)
    assert np.allclose(filled.q, full.q, atol=1e-3)


def test_a_long_gap_is_not_filled_but_named_by_row():
    kept = np.r_[0:100, 120:200]
    channels = {name: x[kept] for name, x in log().channels.items()}
    with pytest.raises(
        RecordingError, match=r"a.csv: t, row 101 .*split the recording"
    ):
        resample(Recording(t=log().t[kept], source="a.csv", **channels))


def test_a_log_with_holes_is_split_where_they_are():
    full = log(samples=1200)
    rate = 1 / (full.t[1] - full.t[0])
    short = round(0.5 * rate)
    kept = np.r_[0:400, 430 : 430 + short, 700:1200]
    channels = {name: x[kept] for name, x in full.channels.items()}
    holed = Recording(t=full.t[kept], source="a.csv", **channels)
    with pytest.warns(HybridWarning, match="a.csv: t, row 401 .*taken as 2 record"):
        first, last = unbroken(holed)
    for part, rows in ((first, slice(0, 400)), (last, slice(700, 1200))):
        assert np.array_equal(part.t, full.t[rows])
        assert np.array_equal(part.q, full.q[rows])
        assert part.source == "a.csv"
    assert unbroken(full) == (full,)


def test_a_log_of_scraps_only_is_left_to_be_refused():
    kept = np.concatenate([np.arange(k, k + 20) for k in range(0, 400, 100)])
    channels = {name: x[kept] for name, x in log(samples=400).channels.items()}
    holed = Recording(t=log(samples=400).t[kept], **channels)
    assert unbroken(holed) == (holed,)


def test_an_output_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path):
    target = tmp_path / "out.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_output_takes_its_place_in_one_step(tmp_path: Path):
    target = tmp_path / "new" / "out.npz"
    with atomic_path(target) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".npz"
        temporary.write_text("whole")
        assert not target.exists()
    assert target.read_text() == "whole"


def test_json_with_nan_is_refused_before_anything_is_written(tmp_path: Path):
    target = tmp_path / "model.json"
    write_json(target, {"unit": "N·m"})
    assert "N·m" in target.read_text(encoding="utf-8")
    with pytest.raises(ValueError):
        write_json(target, {"value": float("nan")})
    assert "N·m" in target.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("lost", "left", "note"),
    [
        (None, {"q", "v", "tau"}, None),
        ("dq", {"q", "tau"}, "v holds no number"),
        ("tau", {"q", "v"}, "tau holds no number"),
    ],
)
def test_a_channel_without_a_number_is_not_there_and_that_is_said(
    tmp_path, lost, left, note
):
    t = np.arange(0.0, 2.0, 0.01)
    table = {"t": t, "q1": np.sin(t), "dq1": np.cos(t), "tau1": 3 * np.sin(t)}
    table |= {x: np.full(len(t), np.nan) for x in table if lost and x[:-1] == lost}
    rows = np.column_stack(list(table.values()))
    np.savetxt(
        tmp_path / "a.csv", rows, delimiter=",", header=",".join(table), comments=""
    )
    found = read(tmp_path / "a.csv", torque=False)
    assert found.has_torque == ("tau" in left)
    assert (found.v is not None) == ("v" in left)
    assert note is None or note in found.reading.notes


def test_a_reading_says_what_each_column_became_in_a_line():
    table = {"t": [0.0, 1.0], "q1 [deg]": [0.0, 1.0], "tau1": [0.0, 1.0], "x": [0, 0]}
    with pytest.warns(HybridWarning, match="ignored columns: x"):
        reading = recording_from_table(table).reading
    assert str(reading).splitlines()[1:] == [
        "t: t [s, assumed]", "q1 [deg]: q joint_1 [deg]",
        "tau1: tau joint_1 [N·m, assumed]", "x: set aside, no word for a channel",
    ]  # fmt: skip


def test_what_names_begin_with_ends_at_a_separator():
    assert _prefix(["arm_left_1", "arm_left_2"]) == "arm_left_"
    assert _prefix(["left/elbow", "left/wrist"]) == "left/"
    assert _prefix(["shoulder_1", "should_2"]) == ""
    assert _prefix(["alone_1"]) == ""


def test_a_resampled_clock_is_told_by_its_samples_and_rate():
    t = np.arange(101) / 50.0
    t[30] += 0.004
    recording = Recording(t=t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None])
    with pytest.warns(HybridWarning, match="2 of 100 steps .* 101 samples at 50 Hz$"):
        resample(recording)
