"""Every format gives back what was written, whatever its columns are called."""

import os
import sys
from codecs import BOM_UTF8
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyarrow import parquet
from rosbags.interfaces import MessageDefinitionFormat

from hybrid.errors import HybridError, HybridWarning, RecordingError
from hybrid.recording import Recording, read, read_all, recording_from_table, write
from hybrid.recording.formats.csv import read_csv
from hybrid.recording.formats.ros import _defined, _frame_size
from hybrid.recording.labels import parse_label, split_unit

# import_module, because the package exports the function of the same name
WRITERS = import_module("hybrid.recording.write").WRITERS
SUFFIXES = (".csv", ".parquet", ".npz")
ARM = ("shoulder", "elbow", "wrist")
FOLDER = settings(
    max_examples=10,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def log(joints: tuple[str, ...] = (), **more) -> Recording:
    rng = np.random.default_rng(1)
    t = np.arange(50) / 100
    q, tau = rng.standard_normal((2, 50, 3))
    return Recording(t=t, q=q, tau=tau, joints=joints, **more)


def text(path: Path, labels: list[str], columns: np.ndarray) -> Path:
    lines = [",".join(labels), *(",".join(map(repr, row)) for row in columns.tolist())]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("joints", [(), ARM, ("a,b", 'c "d"', "é"), ("1", "2", "3")])
def test_what_is_written_reads_back_equal(tmp_path, suffix, joints):
    extra = np.random.default_rng(2).standard_normal((3, 50, 3))
    recording = log(joints, v=extra[0], command=extra[1], temperature=extra[2])
    write(recording, tmp_path / f"log{suffix}")
    again = read(tmp_path / f"log{suffix}", joints=joints or None)
    assert again == recording
    assert again.source.endswith(f"log{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
@FOLDER
@given(
    x=arrays(
        np.float64,
        (3, 2),
        elements=st.floats(allow_nan=False, allow_infinity=False),
    )
)
def test_any_finite_number_reads_back_to_the_last_bit(tmp_path, suffix, x):
    recording = Recording(t=np.array([0.1, 0.2, 0.30000000000000004]), q=x, tau=-x)
    write(recording, tmp_path / f"log{suffix}")
    again = read(tmp_path / f"log{suffix}")
    assert again.q.tobytes() == recording.q.tobytes()
    assert again.tau.tobytes() == recording.tau.tobytes()
    assert again.t.tobytes() == recording.t.tobytes()


@FOLDER
@given(order=st.permutations(range(7)))
def test_columns_by_name_come_in_the_order_of_the_robot(tmp_path, order):
    recording = log(ARM)
    labels = ["time", *(f"q_{j}" for j in ARM), *(f"tau_{j}" for j in ARM)]
    columns = np.column_stack([recording.t, recording.q, recording.tau])
    path = text(
        tmp_path / "log.csv", [labels[k] for k in order], columns[:, list(order)]
    )
    assert read(path, joints=ARM) == recording


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_names_in_another_order_are_put_right_in_every_format(tmp_path, suffix):
    recording = log(ARM)
    write(recording, tmp_path / f"log{suffix}")
    turned = ("wrist", "shoulder", "elbow")
    again = read(tmp_path / f"log{suffix}", joints=turned)
    assert again == recording.in_order(turned)


@pytest.mark.parametrize(
    ("time", "q", "tau", "extra", "channel"),
    [
        ("time", "q{}", "tau{}", "dq{}", "v"),
        ("t", "q_{}", "tau_{}", "v_{}", "v"),
        ("Time", "Q{}", "Torque{}", "qd{}", "v"),
        ("time_s", "position_{}", "effort_{}", "velocity_{}", "v"),
        ("time [s]", "q{} [rad]", "tau{} [N·m]", "dq{} (rad/s)", "v"),
        ("timestamp", "pos{}", "effort{}", "qref{}", "command"),
        ("t", "q[{}]", "tau[{}]", "q_ref[{}]", "command"),
        ("t", "q.{}", "tau.{}", "cmd.{}", "command"),
        ("t", "q{}", "tau{}", "command_{}", "command"),
        (" t", " q{}", " tau{} ", "temp{}", "temperature"),
        ("t", "q{}", "tau{}", "temperature_{} [°C]", "temperature"),
    ],
)
@pytest.mark.parametrize("number", [lambda k: k + 1, lambda k: k])
def test_numbered_columns_are_known_by_many_names(
    tmp_path, time, q, tau, extra, channel, number
):
    recording = log()
    labels = [time]
    labels += [word.format(number(k)) for word in (q, tau, extra) for k in range(3)]
    columns = np.column_stack([recording.t, recording.q, recording.tau, recording.q])
    again = read(text(tmp_path / "log.csv", labels, columns))
    assert np.array_equal(again.tau, recording.tau)
    assert np.array_equal(getattr(again, channel), recording.q)
    assert again.joints == ("joint_1", "joint_2", "joint_3")


def test_the_ending_joint_of_a_name_may_be_left_out(tmp_path):
    labels = ["t", "q_elbow", "q_wrist_1", "tau_wrist_1", "tau_elbow"]
    path = text(tmp_path / "log.csv", labels, np.arange(10.0).reshape(2, 5) / 10)
    recording = read(path, joints=("wrist_1_joint", "elbow_joint"))
    assert recording.q[0].tolist() == [0.2, 0.1]
    assert recording.tau[0].tolist() == [0.3, 0.4]


def test_brackets_hold_a_unit_or_a_joint(tmp_path):
    labels = ["t [s]", "q[elbow] [rad]", "tau[elbow] (N m)", "current_1 [mA]"]
    path = text(tmp_path / "log.csv", labels, np.arange(8.0).reshape(2, 4) / 10)
    with pytest.warns(HybridWarning, match=r"ignored columns: current_1 \[mA\]$"):
        recording = read(path)
    assert recording.joints == ("elbow",)
    assert recording.q[0, 0] == 0.1


@pytest.mark.parametrize(
    "angle, torque", [("[°]", "[Nmm]"), ("(°)", "(N-mm)"), ("[deg]", "[mNm]")]
)
@pytest.mark.parametrize(
    "pattern", ["{c} {j} {u}", "{j}.{c} {u}", "{j} {c}{u}", "{c}_{n} {u}"]
)
def test_a_unit_in_brackets_counts_wherever_the_joint_stands(pattern, angle, torque):
    joints, table = ("elbow_joint", "wrist_joint"), {"t": [0.0, 0.1]}
    for k, joint in enumerate(joints):
        for channel, unit in (("position", angle), ("torque", torque)):
            label = pattern.format(c=channel, j=joint, n=k + 1, u=unit)
            table[label] = [90.0, 180.0]
    log = recording_from_table(table, joints=joints)
    np.testing.assert_allclose(log.q, np.radians([[90, 90], [180, 180]]))
    np.testing.assert_allclose(log.tau, [[0.09, 0.09], [0.18, 0.18]])


@pytest.mark.parametrize("unit, factor", [("Nmm", 1e-3), ("Ncm", 1e-2), ("N_m", 1.0)])
@pytest.mark.parametrize("pattern", ["{j}_torque_{u}", "tau{n}_{u}", "tau_{j}_{u}"])
def test_a_torque_may_end_in_its_unit(pattern, unit, factor):
    joints, table = ("elbow_joint", "wrist_joint"), {"t": [0.0, 0.1]}
    for k, joint in enumerate(joints):
        table[f"{joint}_pos_mrad"] = [500.0, 1000.0]
        table[pattern.format(j=joint, n=k + 1, u=unit)] = [1.0, 2.0]
    log = recording_from_table(table, joints=joints)
    np.testing.assert_allclose(log.tau[0], factor)
    np.testing.assert_allclose(log.q[0], 0.5)


def test_columns_that_end_in_an_unknown_word_are_refused_by_their_label():
    table = {"t": [0.0, 0.1]}
    for joint in ("elbow", "wrist"):
        table |= {f"{joint}_position_counts": [0, 1], f"{joint}_torque": [0, 1]}
    with pytest.raises(
        RecordingError, match="q, as 'elbow_position_counts', are under"
    ):
        recording_from_table(table, joints=("elbow", "wrist"))


@pytest.mark.parametrize("unit", ["%", "counts", "‰"])
@pytest.mark.parametrize(
    "pattern", ["tau_{j} [{u}]", "{j}.effort ({u})", "tau{n} [{u}]"]
)
def test_a_unit_that_nobody_knows_is_refused_and_not_taken_for_si(pattern, unit):
    joints, table = ("elbow_joint", "wrist_joint"), {"t": [0.0, 0.1]}
    for k, joint in enumerate(joints):
        table[f"q_{joint}"] = [0.1, 0.2]
        table[pattern.format(j=joint, n=k + 1, u=unit)] = [1.0, 2.0]
    with pytest.raises(RecordingError, match=rf"is in {unit}; valid are N\*m and"):
        recording_from_table(table, joints=joints)


def test_the_only_joint_needs_no_number(tmp_path):
    path = text(
        tmp_path / "log.csv", ["t", "q", "tau"], np.arange(6.0).reshape(2, 3) / 10
    )
    assert read(path, joints=("hinge",)).tau.tolist() == [[0.2], [0.5]]
    np.savez(tmp_path / "log.npz", t=[0.0, 0.1], q=[1.0, 2.0], effort=[3.0, 4.0])
    assert read(tmp_path / "log.npz").tau.tolist() == [[3.0], [4.0]]


def test_unknown_columns_are_ignored_in_one_warning_that_lists_them(tmp_path):
    labels = ["t", "q1", "tau1", "qmot1", "note", "q_motor1"]
    path = text(tmp_path / "log.csv", labels, np.arange(12.0).reshape(2, 6) / 10)
    with pytest.warns(
        HybridWarning, match="log.csv: ignored columns: qmot1, note, q_motor1$"
    ) as warned:
        recording = read(path)
    assert len(warned) == 1
    assert recording.size == 1


def test_alike_files_of_a_folder_cause_alike_warnings(tmp_path):
    """The screen shows the same line once."""
    for name in ("a.csv", "b.csv"):
        text(tmp_path / name, ["t", "q1", "tau1", "note"], np.arange(8.0).reshape(2, 4))
    with pytest.warns(HybridWarning) as warned:
        read_all(tmp_path)
    assert {str(x.message) for x in warned} == {f"{tmp_path}: ignored columns: note"}


@pytest.mark.parametrize("joints", [None, ("elbow",)])
def test_a_commanded_speed_is_not_the_speed_of_another_joint(tmp_path, joints):
    labels = ["t", "q1", "tau1", "q_cmd1", "dq_cmd1"]
    path = text(tmp_path / "log.csv", labels, np.arange(10.0).reshape(2, 5) / 10)
    with pytest.warns(HybridWarning, match="ignored columns: dq_cmd1$"):
        recording = read(path, joints=joints)
    assert recording.command.tolist() == [[0.3], [0.8]] and recording.v is None


def test_text_in_an_ignored_column_does_no_harm(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,q1,tau1,note\n0,1,2,start\n0.1,2,3,\n")
    with pytest.warns(HybridWarning, match="ignored columns: note"):
        assert read(path).q.tolist() == [[1.0], [2.0]]


@pytest.mark.parametrize(
    "content",
    [
        "t,q1,tau1\n0,1.5,2\n0.1,2,3\n",
        "t,q1,tau1\r\n0,1.5,2\r\n0.1,2,3\r\n",
        "t,q1,tau1\n0,1.5,2\n0.1,2,3",
        "\ufefft,q1,tau1\n0,1.5,2\n0.1,2,3\n\n",
        "t;q1;tau1\n0;1.5;2\n0.1;2;3\n",
        "t;q1;tau1\n0;1,5;2\n0,1;2;3\n",
        "t\tq1\ttau1\n0\t1.5\t2\n0.1\t2\t3\n",
        '"t", "q1", "tau1"\n0, 1.5, 2\n0.1, 2, 3\n',
        "t,q1,tau1\n0,1.5e0,+2\n1E-1,2.,3\n",
        "# t,q1,tau1\n0,1.5,2\n0.1,2,3\n",  # as numpy.savetxt writes
        "# arm 3\n#t q1 tau1\n0 1.5 2\n0.1 2 3\n",
        "# arm 3\n# morning, cold\nt,q1,tau1\n0,1.5,2\n0.1,2,3\n",
        "t,q1,tau1\ns,rad,Nm\n0,1.5,2\n0.1,2,3\n",
        "#\nt;q1;tau1\r\n[ms];;(mN*m)\r\n0;1,5;2e3\r\n100;2;3e3\r\n",
    ],
)
@pytest.mark.parametrize("installed", [True, False])
def test_sane_dialects_of_csv_mean_the_same(tmp_path, monkeypatch, content, installed):
    if not installed:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode())
    recording = read(path)
    assert recording.t.tolist() == [0.0, 0.1]
    assert recording.q.tolist() == [[1.5], [2.0]]
    assert recording.tau.tolist() == [[2.0], [3.0]]


def test_npz_holds_arrays_or_columns(tmp_path):
    recording = log(ARM)
    np.savez(
        tmp_path / "arrays.npz",
        time=recording.t,
        position=recording.q,
        torque=recording.tau,
        joints=ARM,
    )
    assert read(tmp_path / "arrays.npz") == recording
    columns = {f"q{k + 1}": recording.q[:, k] for k in range(3)}
    columns |= {f"tau{k + 1}": recording.tau[:, k] for k in range(3)}
    np.savez(tmp_path / "columns.npz", t=recording.t, **columns)
    assert read(tmp_path / "columns.npz", joints=ARM) == recording


def test_parquet_of_any_kind_of_number_is_read(tmp_path):
    table = {
        "t": pa.array([0.0, 0.5], pa.float32()),
        "q1": pa.array([1, 2], pa.int16()),
        "tau1": pa.array([0.5, 1.5]),
    }
    parquet.write_table(pa.table(table), tmp_path / "log.parquet")
    assert read(tmp_path / "log.parquet").q.tolist() == [[1.0], [2.0]]


def test_folders_globs_and_files_are_lists_of_recordings(tmp_path):
    for name in ("b.csv", "a.parquet", "c.npz"):
        write(log(), tmp_path / name)
    (tmp_path / "README.txt").write_text("not a recording")
    names = [Path(r.source).name for r in read_all(tmp_path)]
    assert names == ["a.parquet", "b.csv", "c.npz"]
    assert len(read_all([tmp_path / "*.csv", str(tmp_path / "c.npz")])) == 2
    assert len(read_all([tmp_path, tmp_path / "b.csv"])) == 3  # not read twice


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_write_that_fails_leaves_the_old_recording(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"log{suffix}"
    write(log(), path)

    def fail(recording: Recording, temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError("disk full")

    monkeypatch.setitem(WRITERS, suffix, fail)
    with pytest.raises(RecordingError, match="cannot be written: disk full"):
        write(log(ARM), path)
    assert read(path) == log()
    assert list(tmp_path.iterdir()) == [path]


def test_files_of_a_folder_that_hold_no_joint_are_left_out_and_said(tmp_path):
    good, other = tmp_path / "a.csv", tmp_path / "b.h5"
    write(log(), good)
    with h5py.File(other, "w") as file:
        for k in range(2):
            file[f"demo_{k}/humidity"] = np.arange(200.0)
    with pytest.warns(HybridWarning, match="left out: .*b.h5"):
        (found,) = read_all(tmp_path)
    assert found.source == str(good)
    with pytest.raises(RecordingError, match="b.h5"):
        read_all([tmp_path, other])  # it is asked for by itself as well
    good.rename(tmp_path / "a.txt")
    (tmp_path / "c.h5").write_bytes(other.read_bytes())
    with (
        pytest.raises(RecordingError, match="no file there holds joints"),
        pytest.warns(HybridWarning, match="left out"),
    ):
        read_all(tmp_path)
    with pytest.raises(RecordingError, match="no paths given"):
        read_all([])


@pytest.mark.parametrize(
    "table", ["pose,x,y\n1,0.1,0.2\n", "t,x\n0.1,1\n0.2,2\n", "name,value\na,1\n"]
)
def test_a_table_without_joints_stops_no_folder(tmp_path, table):
    write(log(), tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(table)
    with pytest.warns(HybridWarning, match="left out: .*b.csv"):
        (found,) = read_all(tmp_path)
    assert found.source == str(tmp_path / "a.csv")
    (tmp_path / "a.csv").unlink()
    with pytest.raises(RecordingError, match="b.csv: no .* among"):
        read_all(tmp_path)


def test_a_log_without_a_clock_stops_a_folder(tmp_path):
    write(log(), tmp_path / "a.csv")
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "b.csv").write_text(text.replace("time", "x", 1))
    with pytest.raises(RecordingError, match="b.csv: no column of time"):
        read_all(tmp_path)


@pytest.mark.parametrize(
    ("label", "channel", "joint", "number"),
    [
        ("q_shoulder_actual", "q", "shoulder", None),
        ("position_shoulder_actual", "q", "shoulder", None),
        ("shoulder_pos_desired", "command", "shoulder", None),
        ("elbow_torque_meas", "tau", "elbow", None),
        ("velocity/elbow/measured", "v", "elbow", None),
        ("q_actual_shoulder", "q", "shoulder", None),
        ("actual_q_0", "q", "0", 0),
        ("q1_ref", "command", "1", 1),
        ("position_1_actual", "q", "1", 1),
    ],
)
def test_words_around_a_label_say_what_it_is_of_and_are_no_joint(
    label, channel, joint, number
):
    found = parse_label(label)
    assert (found.channel, found.joint, found.number) == (channel, joint, number)


@pytest.mark.parametrize(
    ("label", "text", "unit"),
    [
        ("t/s", "t", "s"),
        ("time / ms", "time", "ms"),
        ("q1/deg", "q1", "deg"),
        ("base.position in rad", "base.position", "rad"),
        ("arm/base/velocity / deg/s", "arm/base/velocity", "deg/s"),
        ("v_base/rad/s", "v_base", "rad/s"),
        ("tau_base / N·m", "tau_base", "N·m"),
        ("base_torque/Nm", "base_torque", "Nm"),
        ("/joint_states/position/a", "/joint_states/position/a", ""),
        ("/joint_states/header/stamp/sec", "/joint_states/header/stamp/sec", ""),
    ],
)
def test_a_label_divided_by_its_unit_states_it(label, text, unit):
    assert split_unit(label) == (text, unit)


def test_a_torque_that_is_commanded_is_not_taken_for_a_measured_one():
    found = parse_label("tau_elbow_desired")
    assert found.channel == "" and "commanded" in found.why


@pytest.mark.parametrize("zone", ["", "Z", "+00:00", "+02:00", "-0330"])
@pytest.mark.parametrize("installed", [True, False])
def test_dates_of_any_zone_are_a_clock(tmp_path, monkeypatch, zone, installed):
    if not installed:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    rows = [f"2023-11-14T22:13:20.{k:02d}{zone},{k / 7},{k / 3}" for k in range(50)]
    (tmp_path / "log.csv").write_text("\n".join(["time,q1,tau1", *rows]))
    found = read(tmp_path / "log.csv")
    np.testing.assert_allclose(found.t - found.t[0], np.arange(50) / 100, atol=1e-6)
    np.testing.assert_allclose(found.q[:, 0], np.arange(50) / 7)


def test_without_pyarrow_parquet_alone_is_refused_and_the_line_names_its_extra(
    tmp_path, monkeypatch
):
    write(log(), tmp_path / "log.parquet")
    monkeypatch.setattr("hybrid.extras.find_spec", lambda name: None)
    for call in (read, lambda path: write(log(), path)):
        with pytest.raises(HybridError, match=r"pip install 'hybrid-arm\[parquet\]'$"):
            call(tmp_path / "log.parquet")
    write(log(), tmp_path / "log.csv")
    assert read(tmp_path / "log.csv") == log()


@given(
    cells=st.lists(
        st.sampled_from(
            [
                "",
                " ",
                "1",
                " 2.5 ",
                "+3",
                "-4e-3",
                ".5",
                "6.",
                "nan",
                "inf",
                "-Infinity",
            ]
            + [
                "0.1234567890123456789",
                "1e400",
                "1_0",
                "0x1",
                "-0X1F",
                "007",
                "1.5",
                "1e3",
                "x",
                "1700000000123456789",
            ]
        ),
        min_size=1,
        max_size=8,
    )
)
@example(cells=["1700000000123456789", "0x1"])
@example(cells=["1700000000123456789", "-0X1F"])
def test_a_column_of_csv_is_the_same_with_and_without_pyarrow(tmp_path_factory, cells):
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    rows = [f"{k / 10},{cell},{k}" for k, cell in enumerate(cells)]
    path.write_text("\n".join(["t,q1,tau1", *rows]))

    def column():
        ((table,),) = read_csv(path)
        try:
            (block,) = table.load((1,))
            return block[1].tolist()
        except RecordingError as error:
            return str(error)

    with pytest.MonkeyPatch.context() as patch:
        by_arrow = column()
        patch.setitem(sys.modules, "pyarrow", None)
        assert repr(by_arrow) == repr(column())


def test_dates_of_any_zone_in_text_are_one_clock(tmp_path):
    rows = ["2026-01-05 10:00:00Z,1,2", "2026-01-05T11:00:00.25+01:00,2,3"]
    (tmp_path / "log.csv").write_text("\n".join(["time,q1,tau1", *rows]))
    assert np.diff(read(tmp_path / "log.csv").t).tolist() == [0.25]


def test_a_frame_of_pandas_may_have_zones_and_lists():
    dates = pd.to_datetime([0, 250], unit="ms", utc=True)
    lists = {"time": dates, "q": [[1.0, 2.0], [3.0, 4.0]], "tau": [[5, 6], [7, 8]]}
    recording = recording_from_table(pd.DataFrame(lists))
    assert np.diff(recording.t).tolist() == [0.25]
    assert recording.q.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    ragged = pd.DataFrame(lists | {"q": [[1.0], [3.0, 4.0]]})
    with pytest.raises(RecordingError, match="lists of 'q' of many lengths"):
        recording_from_table(ragged)
    texts = pd.DataFrame({"time": ["0.0", "0.1"], "q1": [1.0, 2.0]}, dtype=object)
    with pytest.raises(RecordingError, match="time holds '0.0'; valid are numbers"):
        recording_from_table(texts)


def test_the_longest_name_of_a_joint_in_a_label_is_meant():
    both = ("arm", "left arm")
    for joints in (both, both[::-1]):
        assert parse_label("left arm/position", joints).joint == "left arm"
        assert parse_label("arm/position", joints).joint == "arm"


@pytest.mark.parametrize("joints", [("J", "j"), ("j", "J"), ("q", "tau"), ("tau", "q")])
def test_what_is_written_reads_back_whatever_joints_are_called(tmp_path, joints):
    t, x = np.arange(20) / 10, np.arange(80.0).reshape(20, 4)
    log = Recording(t, x[:, :2], x[:, 2:], v=2 * x[:, :2], joints=joints)
    write(log, tmp_path / "log.csv")
    (found,) = read_all([tmp_path / "log.csv"], joints=joints)
    for channel in ("q", "tau", "v"):
        np.testing.assert_array_equal(getattr(found, channel), getattr(log, channel))


def test_a_byte_order_mark_may_stand_before_a_comment(tmp_path):
    rows = "".join(f"{k / 10},{k},{2 * k}\n" for k in range(5))
    path = tmp_path / "log.csv"
    path.write_bytes(BOM_UTF8 + f"# by a drive\nt,q1,tau1\n{rows}".encode())
    assert read(path).q[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("whole", [0, 1, 2, 7])
def test_decimal_commas_may_begin_below_rows_of_whole_numbers(tmp_path, whole):
    first = [f"{k};1;2" for k in range(whole)]
    rows = [f"{k};1,5;-2,25" for k in range(whole, whole + 5)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t;q1;tau1", *first, *rows]))
    found = read(path)
    assert found.q[:, 0].tolist() == [1.0] * whole + [1.5] * 5
    assert found.tau[:, 0].tolist() == [2.0] * whole + [-2.25] * 5


def test_lines_that_end_in_a_carriage_return_alone_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"t,q1,tau1\r0,1,2\r0.1,1,2\r")
    with pytest.raises(RecordingError, match="CR alone; valid are LF, and CR with LF"):
        read(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX")
def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(RecordingError, match="a pipe or a device; valid are files"):
        read_all([tmp_path / "log.csv"])
    with pytest.raises(RecordingError, match="no recordings there"):
        read_all([tmp_path])


def test_a_frame_states_its_unpacked_size_as_rfc_8878_says():
    """Sizes below 256, of two bytes and 256 more, of four and of eight bytes."""
    magic = b"\x28\xb5\x2f\xfd"
    for flags, window, size, data in (
        (0x20, b"", 200, (200).to_bytes(1, "little")),
        (0x60, b"", 1000, (1000 - 256).to_bytes(2, "little")),
        (0x40, b"\x10", 65000, (65000 - 256).to_bytes(2, "little")),
        (0xA0, b"", 70_000, (70_000).to_bytes(4, "little")),
        (0xC1, b"\x10\x07", 2**40, (2**40).to_bytes(8, "little")),
        (0x00, b"\x10", 0, b""),
    ):
        frame = magic + bytes([flags]) + window + data
        assert _frame_size(frame + b"\xff" * 9) == size
    assert _frame_size(b"no frame of zstandard") == 0


def test_a_type_that_a_bag_defines_in_idl_is_read_below_its_heading():
    text = (
        "=" * 80 + "\nIDL: my_msgs/msg/Joint\n"
        "module my_msgs { module msg { struct Joint {\n"
        "  double angle;\n  sequence<double> torque;\n}; }; };\n"
    )
    kind = "my_msgs/msg/Joint"
    definition = SimpleNamespace(format=MessageDefinitionFormat.IDL, data=text)
    types = _defined(SimpleNamespace(msgdef=definition, msgtype=kind))
    assert [name for name, _ in types[kind][1]] == ["angle", "torque"]


def test_arrays_of_hdf5_without_a_clock_or_a_rate_are_refused(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in ("q1", "tau1"):
            file[name] = np.arange(200.0)
    with pytest.raises(RecordingError, match="no column of time"):
        read(tmp_path / "log.h5")


@pytest.mark.parametrize("count", [2, 6, 7])
def test_several_recordings_are_named_up_to_six_where_one_is_asked_for(tmp_path, count):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for k in range(count):
            for name in ("t", "q1", "tau1"):
                file[f"demo_{k}/{name}"] = np.arange(20.0)
    with pytest.raises(RecordingError) as caught:
        read(tmp_path / "log.h5")
    assert f": {count} recordings (demo_0, demo_1" in str(caught.value)
    assert (" ...) where" in str(caught.value)) == (count > 6)
