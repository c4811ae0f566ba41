"""Whatever a log is written in, the same recording is read."""

import struct
import sys
import warnings
import zlib
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import h5py
import logs
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from logs import ARM, DIALECTS, START, Messages, bag, columns, states, truth
from rosbags.rosbag2 import StoragePlugin

from hybrid.cli.shared.options import read_logs
from hybrid.cli.shared.screen import Screen
from hybrid.errors import HybridError, HybridWarning, RecordingError
from hybrid.recording import Recording, read, read_all, recording_from_table
from hybrid.recording.formats.mat import check_elements
from hybrid.recording.formats.parquet import read_parquet_or_episodes

REAL = Path(__file__).parents[2] / "shared" / "data" / "ur10_bag"
TEXTS = (*DIALECTS, "gzip", "tab", "other units", "ur_rtde", "ur_rtde, spaces",
         "rostopic echo", "libfranka", "pandas index", "nanoseconds", "bare stamps",
         "gripper", "map")  # fmt: skip
TABLES = ("pandas parquet", "polars parquet", "lists",
          "lists beside names", "npz", "npz of names", "hdf5",
          "robomimic", "mat", "mat struct", "mat 7.3")  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, tuple[Path, dict]]:
    folder = tmp_path_factory.mktemp("logs")
    return logs.text_files(folder) | logs.table_files(folder)


def taken(read, *args, **options):
    """What is read, whatever was set aside."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return read(*args, joints=ARM, **options)


def differences(recording: Recording, *, without: tuple[str, ...] = ()) -> list[str]:
    """What of a recording is not the truth, by name."""
    log = truth()
    found = [] if recording.joints == ARM else ["joints"]
    if not np.allclose(recording.t - recording.t[0], log.t, atol=1e-9):
        found.append("t")
    for name in {*log.channels} - {*without}:
        x = getattr(recording, name)
        if x is None or not np.allclose(x, log.channels[name], rtol=1e-9, atol=1e-9):
            found.append(name)
    return found


@pytest.mark.parametrize("name", [*TEXTS, *TABLES])
def test_every_dialect_and_format_reads_to_the_same_recording(files, name):
    path, options = files[name]
    recording = taken(read, path, **options)
    assert not differences(recording)
    used = recording.reading.columns
    assert used[0].channel == "t" and len(used) == 1 + 6 * 4
    assert [u.joint for u in used if u.channel == "q"] == list(ARM)


@pytest.mark.parametrize("make", [
    lambda x: x, pl.DataFrame, pa.table, pd.DataFrame,
    lambda x: pd.DataFrame(x).set_index("time"),
])  # fmt: skip
def test_a_table_in_memory_is_read_like_a_file(make):
    log = truth()
    table = {"time": log.t} | columns(log, DIALECTS["named"], logs.ALPHABETICAL)
    assert not differences(recording_from_table(make(table), joints=ARM))


def test_what_is_no_table_is_refused():
    with pytest.raises(RecordingError, match="list is no table; valid are"):
        recording_from_table([1, 2])


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    order=st.permutations(ARM),
    dialect=st.sampled_from(sorted(DIALECTS)),
    seed=st.integers(0, 99),
)
def test_any_order_of_joints_and_columns_in_any_dialect_is_the_same(
    order, dialect, seed
):
    log, label = truth(20), DIALECTS[dialect]
    order = order if "{joint}" in label("q", 0, "{joint}") else ARM
    table = list(({"time": log.t} | columns(log, label, order)).items())
    np.random.default_rng(seed).shuffle(table)
    assert recording_from_table(dict(table), joints=ARM) == log


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_bag_of_ros_2_is_read_by_the_names_in_its_messages(tmp_path, storage):
    path = bag(tmp_path / "bag", states(Messages()), Messages(), storage)
    for place in (path, next(path.glob("*.[dm]*[3p]"))):
        recording = taken(read, place)
        assert not differences(recording, without=("command",))
        assert recording.reading.preset == "joint_state"
    assert len(taken(read_all, [tmp_path])) == 1


def test_a_bag_of_compressed_chunks_is_read(tmp_path):
    messages, storage = Messages(), StoragePlugin.MCAP
    path = bag(tmp_path / "bag", states(messages), messages, storage, packed=True)
    assert not differences(taken(read, path), without=("command",))


def test_dynamic_joint_states_are_read_by_their_names(tmp_path):
    messages, log = Messages(), truth()
    at, content = [ARM.index(joint) for joint in logs.ALPHABETICAL], []
    for k, t in enumerate(log.t):
        stamp = START + round(t * 1e9)
        rows = np.stack([log.q[k, at], log.v[k, at], log.tau[k, at]], axis=1)
        message = messages.dynamic(stamp, logs.ALPHABETICAL, rows)
        content.append(("/dynamic_joint_states", stamp, message))
    recording = taken(read, bag(tmp_path / "bag", content, messages))
    assert not differences(recording, without=("command",))


def test_a_bag_of_ros_1_is_read_by_the_names_in_its_messages(tmp_path):
    messages = Messages(ros1=True)
    path = bag(tmp_path / "log.bag", states(messages), messages)
    assert not differences(taken(read, path), without=("command",))


@pytest.mark.skipif(not REAL.exists(), reason="the real bag is not here")
def test_a_real_bag_is_what_its_owner_made_a_table_of():
    with pytest.warns(HybridWarning, match="left out: .*no joint states there"):
        (recording,) = read_all(REAL, joints=ARM)
    table = read(REAL.parent / "ur10_salerno" / "exciting_1.csv", joints=ARM)
    assert np.allclose(recording.t, table.t, atol=1e-8)
    for name, x in table.channels.items():
        # The table has five digits.
        assert np.allclose(recording.channels[name], x, rtol=1e-4, atol=1e-5), name


def test_alphabetical_order_in_a_bag_is_not_misread_without_a_robot(tmp_path):
    path = bag(tmp_path / "bag", states(Messages()), Messages())
    recording = read(path)
    assert recording.joints == logs.ALPHABETICAL
    assert not differences(recording.in_order(ARM), without=("command",))


def test_a_gripper_beside_the_arm_is_set_aside_and_said(tmp_path):
    messages, log = Messages(), truth()
    content = states(messages)
    grip = [0.5]
    for t in log.t:
        stamp = START + round(t * 1e9) + 50
        message = messages.state(stamp, ["finger"], grip, grip, grip)
        content.append(("/joint_states", stamp, message))
        content.append(("/gripper/joint_states", stamp, message))
    recording = taken(read, bag(tmp_path / "bag", content, messages))
    assert not differences(recording, without=("command",))


@pytest.mark.parametrize("kind", ["state", "plan"])
def test_a_command_comes_from_the_controller_or_the_trajectory(tmp_path, kind):
    messages, log = Messages(), truth()
    content = states(messages)
    if kind == "state":
        for k, t in enumerate(log.t):
            stamp = START + round(t * 1e9)
            message = messages.control(stamp, ARM, log.command[k], log.q[k])
            content.append(("/controller/state", stamp, message))
    else:
        points = [messages.point(x, after=round(t * 1e9))
                  for t, x in zip(log.t, log.command, strict=True)]  # fmt: skip
        plan = messages.plan(START, ARM, points)
        content.append(("/controller/joint_trajectory", START, plan))
    path = bag(tmp_path / "bag", content, messages)
    for torque in (True, False):
        recording = taken(read, path, torque=torque)
        assert not differences(recording)
        assert any("command of /controller" in x for x in recording.reading.notes)
    counted = taken(read, path, map={"time": {"rate": 50.0}})
    np.testing.assert_array_equal(counted.command, recording.command)
    assert counted.t[1] == 1 / 50.0


def test_joints_in_several_topics_are_told_apart_by_the_map(tmp_path):
    messages, log = Messages(), truth()
    other = [
        ("/sim/joint_states", at, message)
        for _, at, message in states(messages, log=replace(log, q=log.q + 1))
    ]
    path = bag(tmp_path / "bag", states(messages) + other, messages)
    with pytest.raises(RecordingError, match="several topics: .*; valid is --map"):
        taken(read, path)
    recording = taken(read, path, map={"topic": "/joint_states"})
    assert not differences(recording, without=("command",))


def test_a_bag_without_joints_says_what_it_holds(tmp_path):
    messages = Messages()
    path = bag(tmp_path / "bag", [("/p", 5, messages.plan(5, ARM, []))] * 2, messages)
    with pytest.raises(
        RecordingError, match=r"no joint states there; it holds /p \(tr"
    ):
        read(path)


def test_a_bag_that_is_cut_is_refused(tmp_path):
    messages = Messages()
    path = bag(tmp_path / "bag", states(messages), messages, StoragePlugin.MCAP)
    (file,) = path.glob("*.mcap")
    whole = file.read_bytes()
    for share in (0.0, 0.02, 0.5, 0.99):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(RecordingError, match="truncated"):
            read(cut)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_a_lerobot_dataset_are_recordings(tmp_path, version):
    folder = logs.lerobot(tmp_path / "data", version, episodes=3)
    with pytest.raises(RecordingError, match="no torques"):
        taken(read_all, folder)
    found = taken(read_all, folder, torque=False)
    assert [r.reading.name for r in found] == [f"episode {k}" for k in range(3)]
    for recording in found:
        assert not differences(recording, without=("v", "tau"))
        assert any("gripper" in label for label, _ in recording.reading.aside)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_file_of_a_lerobot_dataset_has_its_episodes_and_joints(
    tmp_path, version, monkeypatch
):
    folder = logs.lerobot(tmp_path / "data", version, episodes=3)
    every = taken(read_all, folder, torque=False)
    monkeypatch.chdir(folder / "data" / "chunk-000")
    files = sorted(Path().glob("*.parquet"))
    found = [r for x in files for r in taken(read_all, x, torque=False)]
    assert [r.reading.name for r in found] == [f"episode {k}" for k in range(3)]
    for one, same in zip(found, every, strict=True):
        assert one.joints == same.joints
        np.testing.assert_array_equal(one.q, same.q)
    # Copied away from the names of its joints, a file still has its episodes.
    copied = files[0].rename(tmp_path / "copied.parquet")
    with pytest.raises(RecordingError, match=r"episode 0.*unknown joints: number 6"):
        taken(read_all, copied, torque=False)
    with pytest.warns(HybridWarning, match="units are not in a LeRobot dataset"):
        own = read_all(copied, torque=False, joints=(*ARM, "gripper"))
    for one, same in zip(own, every, strict=False):
        assert one.reading.name == same.reading.name
        np.testing.assert_array_equal(one.q[:, :6], same.q)
    copied.rename(files[0])
    # A table beside the dataset's own files is a table.
    own = folder / "own.parquet"
    whole = logs.parquet.read_table(files[0])
    logs.parquet.write_table(whole.drop_columns(["episode_index"]), own)
    ((table,),) = read_parquet_or_episodes(own)
    assert table.kind == "Parquet" and not table.name


def test_units_of_a_lerobot_dataset_come_from_the_map(tmp_path):
    folder = logs.lerobot(tmp_path / "data", "v3.0")
    with pytest.warns(HybridWarning, match="units are not in a LeRobot dataset"):
        read_all(folder, torque=False)
    degrees = {"q": {"unit": "deg"}}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[^ ]*: ignored columns")
        (recording,) = read_all(folder, torque=False, map=degrees, joints=ARM)
    assert np.allclose(recording.q, np.radians(truth().q))


def test_currents_become_torques_only_with_a_torque_constant(tmp_path):
    log = truth()
    path = logs.csv(tmp_path / "a.csv", columns(log, logs.RTDE), "timestamp")
    with pytest.raises(RecordingError, match="no torques, but currents .*torque_const"):
        taken(read, path)
    recording = taken(read, path, torque=False)
    assert not recording.has_torque and recording.reading.preset == "ur_rtde"
    assert any("torque_constant" in why for _, why in recording.reading.aside)


def test_a_torque_constant_is_for_currents_and_nothing_else():
    log = truth()
    table = {"t": log.t} | columns(log, DIALECTS["hybrid"])
    constant = {"tau": {"torque_constant": 2.0, "columns": "tau{}"}}
    found = taken(recording_from_table, table, map=constant)
    assert {u.unit for u in found.reading.columns if u.channel == "tau"} == {"A"}
    assert np.allclose(found.tau, 2 * log.tau)
    table |= {f"{k} [Nm]": table.pop(k) for k in [f"tau{j}" for j in range(1, 7)]}
    with pytest.raises(RecordingError, match="is in Nm; .* or a current with torque_c"):
        taken(recording_from_table, table, map={"tau": {"torque_constant": 2.0}})


def test_a_map_is_a_file_a_preset_or_a_dict(tmp_path):
    log = truth()
    path = logs.csv(tmp_path / "a.csv", columns(log, logs.RTDE), "timestamp")
    (tmp_path / "map.yaml").write_text("preset: ur_rtde\ntau: {torque_constant: 1}\n")
    assert not differences(taken(read, path, map=tmp_path / "map.yaml"))
    assert not taken(read, path, map="ur_rtde", torque=False).has_torque


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"Q": "a"}, "unknown 'Q'; valid are keys preset, joints"),
        ({"q": "angle_{}"}, "no column like 'angle_{}' for q of map among time"),
        ({"q": ["nope"]}, "no column 'nope' for q of map among time, q1"),
        ({"tau": {"gear_ratio": [1, np.inf]}}, "gear_ratio is inf; valid are numbers"),
        ({"tau": {"scale": [1, 2]}}, "the map gives 2 numbers as scale for 6 joints"),
        ({"time": "clock"}, "no column 'clock' among time, q1"),
        ("my.json", "my.json: no map; valid are a .yaml file and ur_rtde"),
        ("none.yaml", "none.yaml: not a readable YAML file"),
    ],
)
def test_a_map_that_fits_nothing_says_what_is_valid(tmp_path, content, message):
    log = truth()
    path = logs.csv(tmp_path / "a.csv", columns(log, DIALECTS["hybrid"]))
    with pytest.raises(RecordingError) as error:
        taken(read, path, map=content)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_the_command_line_takes_a_map(tmp_path):
    log = truth()
    path = logs.csv(tmp_path / "a.csv", columns(log, logs.RTDE), "timestamp")
    (tmp_path / "map.yaml").write_text("tau: {torque_constant: 1.0}\n")
    how = str(tmp_path / "map.yaml")
    given = Namespace(recordings=[str(path)], map=how, inputs=[])
    (recording,) = taken(lambda joints: read_logs(given, Screen(), joints))
    assert not differences(recording)
    assert given.inputs == [path, tmp_path / "map.yaml"]


def test_a_library_that_is_not_there_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.h5").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(HybridError, match=r"pip install 'hybrid-arm\[hdf5\]'$"):
        read(tmp_path / "a.h5")


def test_a_heap_of_hdf5_that_never_ends_is_refused(tmp_path):
    """The library would walk it for ever: what is left of a heap takes no room."""
    path, t = tmp_path / "log.h5", np.arange(5.0)
    with h5py.File(path, "w") as file:
        file["t"], file["q"], file["tau"] = t, np.zeros((5, 2)), np.ones((5, 2))
        file["q"].attrs["units"] = "deg"  # text is what lies in a heap
    assert read(path).q.shape == (5, 2)
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    free = heap + 16 + 16 + 8  # behind the heap's header and one word
    assert data[free : free + 8] == bytes(8)
    data[free + 8 : free + 16] = bytes(8)
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=f"heap at byte {heap} is damaged"):
        read(path)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    ("at", "byte"),
    [(48, 73), (48, 14), (48, 0), (17, 0x08), (16, 5)],
    ids=["no type", "an array for numbers", "type 0", "complex", "sparse"],
)
def test_an_array_of_matlab_without_the_numbers_of_its_class_is_refused(
    tmp_path, at, byte, compressed
):
    """SciPy would look the type up beyond its table, or read on beyond the array."""
    path = tmp_path / "log.mat"
    content = {"t": np.arange(5.0), "q": np.zeros((5, 2)), "tau": np.ones((5, 2))}
    scipy.io.savemat(path, content)
    assert read(path).q.shape == (5, 2)
    data = bytearray(path.read_bytes())
    array = data[128 : 128 + 8 + data[132]]
    assert array[48] == 9  # doubles: behind flags, dimensions and a short name
    array[at] = byte
    if compressed:
        packed = zlib.compress(array)
        array = struct.pack("<II", 15, len(packed)) + packed
    path.write_bytes(data[:128] + array)
    with pytest.raises(RecordingError, match="is not of its type"):
        read(path)


def test_a_matrix_without_rows_may_not_state_any_number_of_columns(tmp_path):
    """22 bytes of version 4: 300 million columns took 41 s and 6 GB to be labelled."""
    path = tmp_path / "log.mat"
    path.write_bytes(struct.pack("<5i", 0, 300_000_000, 0, 0, 2) + b"q\0")
    with pytest.raises(RecordingError, match="q: 300000000 columns; valid are up"):
        read(path)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"] = np.zeros(0)
        file.create_dataset("q", shape=(0, 300_000_000), dtype="f8")
    with pytest.raises(RecordingError, match="q: 300000000 columns; valid are up"):
        read(tmp_path / "log.h5")


def test_what_scipy_reads_of_its_own_files_is_not_refused():
    folder = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    files = [
        x for x in folder.glob("*.mat") if b"MATLAB 7.3" not in x.read_bytes()[:10]
    ]
    for path in files or pytest.skip("SciPy came without its tests"):
        try:
            check_elements(path)
        except (ValueError, zlib.error):
            with pytest.raises((ValueError, TypeError, zlib.error)):
                scipy.io.loadmat(path)


def test_links_of_hdf5_to_other_files_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["q"] = np.ones((5, 1))
    layout = h5py.VirtualLayout(shape=(5, 1), dtype="f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "q", shape=(5, 1))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"], file["tau"] = np.arange(5.0), np.ones((5, 1))
        file["q"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "q")
        file.create_virtual_dataset("qpos", layout)
    with pytest.raises(RecordingError, match="no positions among"):
        read(tmp_path / "log.h5")


def test_a_chunk_that_unpacks_to_more_than_any_log_is_refused(tmp_path):
    messages = Messages()
    path = bag(tmp_path / "bag", states(messages), messages, StoragePlugin.MCAP)
    content = bytearray(next(path.glob("*.mcap")).read_bytes())
    at = 8
    while content[at] != 6:  # a chunk: its size unpacked follows two times
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    content[at + 25 : at + 33] = (1 << 40).to_bytes(8, "little")
    (tmp_path / "log.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match="1099511627776 bytes of a chunk"):
        read(tmp_path / "log.mcap")


def test_a_log_without_a_clock_is_read_at_the_rate_of_the_map():
    log = truth()
    table = {"observations/qpos": log.q, "observations/effort": log.tau}
    with pytest.raises(RecordingError, match="no column of time"):
        recording_from_table(table, joints=ARM)
    found = taken(recording_from_table, table, map={"time": {"rate": 125}})
    assert np.allclose(found.t, log.t) and np.array_equal(found.tau, log.tau)


def test_the_file_that_libfranka_writes_is_in_milliseconds_with_two_commands(tmp_path):
    """The header of ``franka::logToCSV``: states, and the commands for them."""
    log, words = truth(), ("state.q", "state.q_d", "state.dq", "state.tau_J", "cmd.q_d")
    channels = log.q, log.command, log.v, log.tau, log.q
    table = {
        f"{word}[{k}]": x[:, k]
        for word, x in zip(words, channels, strict=True)
        for k in range(6)
    }
    table |= {f"cmd.O_T_EE_d[{k}]": log.t for k in range(16)} | {"success_rate": log.t}
    path = logs.csv(tmp_path / "log.csv", table, "time", t=1e3 * log.t)
    recording = taken(read, path)
    assert not differences(recording)
    assert recording.reading.preset == "libfranka_log"
    assert ("cmd.q_d[5]", "not used") in recording.reading.aside


def test_the_effort_of_a_driver_that_logs_currents_needs_its_constants(tmp_path):
    messages, log = Messages(), truth()
    currents = replace(log, tau=log.tau / 12.0)
    path = bag(tmp_path / "bag", states(messages, log=currents), messages)
    with pytest.raises(
        RecordingError, match=r"no torques, but currents .*torque_const"
    ):
        taken(read, path, map="ur_driver")
    given = {"preset": "ur_driver", "tau": {"torque_constant": 12.0}}
    assert np.allclose(taken(read, path, map=given).tau, log.tau)


def test_torques_that_hold_no_number_are_not_measured(tmp_path):
    messages, log = Messages(), truth()
    content = [
        ("/joint_states", START + 8_000_000 * k,
         messages.state(START + 8_000_000 * k, ARM, x, x, np.full(6, np.nan)))
        for k, x in enumerate(log.q)
    ]  # fmt: skip
    path = bag(tmp_path / "bag", content, messages)
    with pytest.raises(RecordingError, match="no torques: tau holds no number"):
        taken(read, path)
    recording = taken(read, path, torque=False)
    assert not recording.has_torque and "tau holds no number" in recording.reading.notes


def test_a_speed_that_holds_no_number_is_not_measured():
    log = truth()
    table = {"t": log.t} | columns(log, DIALECTS["hybrid"])
    speeds = [DIALECTS["hybrid"]("v", k, joint) for k, joint in enumerate(ARM)]
    table |= {name: np.full(len(log.t), np.nan) for name in speeds}
    recording = taken(recording_from_table, table)
    assert recording.v is None and recording.has_torque
    assert "v holds no number" in recording.reading.notes


def test_plain_labels_come_before_those_of_motors():
    log = truth()
    table = {"t": log.t} | columns(log, DIALECTS["hybrid"])
    table |= {f"motor_position_{k}": 100 * log.q[:, k] for k in range(6)}
    recording = taken(recording_from_table, table)
    assert not differences(recording)
    assert "of the motor" in dict(recording.reading.aside)["motor_position_0"]


def test_a_unit_that_the_file_states_is_above_a_preset():
    log = truth()
    degrees = {f"position_{k} [deg]": np.degrees(log.q[:, k]) for k in range(6)}
    table = {"t": log.t} | degrees
    found = taken(recording_from_table, table, map="joint_state", torque=False)
    assert np.allclose(found.q, log.q)


def test_a_column_in_units_that_no_channel_has_is_refused(tmp_path):
    log = truth()
    table = columns(log, DIALECTS["hybrid"])
    table["tau1 [A]"] = table.pop("tau1")
    path = logs.csv(tmp_path / "a.csv", table)
    with pytest.raises(
        RecordingError, match=r"'tau1 \[A\]' is in A; .*torque_constant"
    ):
        taken(read, path)


def test_joints_that_the_arm_does_not_have_are_set_aside(files):
    path, _ = files["gripper"]
    with pytest.warns(HybridWarning, match="ignored columns: q_gripper, tau_gripper"):
        recording = read(path, joints=ARM)
    why = dict(recording.reading.aside)
    assert why["q_gripper"] == "gripper is no joint of the arm"


def test_a_reading_says_what_each_column_was_taken_for(files):
    path, _ = files["other units"]
    used = {u.label: u for u in taken(read, path).reading.columns}
    assert used["time_ms"].unit == "ms" and used["time_ms"].channel == "t"
    assert used["q2 [deg]"].joint == "shoulder_lift_joint"
    assert used["q2 [deg]"].factor == pytest.approx(np.pi / 180)
    assert used["tau1 [mNm]"].factor == pytest.approx(1e-3)


def test_a_prefix_of_the_driver_is_no_part_of_a_name():
    log = truth()
    for prefixed in ([f"ur10e_{x}" for x in ARM], [x[:-6] for x in ARM]):
        names = dict(zip(ARM, prefixed, strict=True))
        table = {f"q_{names[j]}": log.q[:, k] for k, j in enumerate(ARM)}
        table |= {f"tau_{names[j]}": log.tau[:, k] for k, j in enumerate(ARM)}
        found = recording_from_table({"t": log.t} | table, joints=ARM)
        assert np.array_equal(found.q, log.q) and np.array_equal(found.tau, log.tau)
