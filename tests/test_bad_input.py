"""Bad input ends in one line that names file, column and row, or in a warning."""

import struct
import tracemalloc
import warnings
import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from hybrid import (
    OnlineIdentifier,
    calibrate,
    diagnose,
    export,
    fit_servo,
    identify,
    inspect_recording,
    predict,
    simulate,
    validate,
)
from hybrid.errors import HybridError, HybridWarning, RecordingError
from hybrid.inspect import check_recordings
from hybrid.recording import Recording, read, read_all, write
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

DATA = Path(__file__).parents[2] / "shared" / "data"
SUFFIXES = (".csv", ".parquet", ".npz")
ARM = ("shoulder", "elbow", "wrist")
GOOD = "time,q1,q2,tau1,tau2\n0,1,2,3,4\n0.1,1.1,2.1,3.1,4.1\n0.2,1.2,2.2,3.2,4.2\n"


def robot(
    q_min=(-3.0, -1.5, -6.0),
    q_max=(3.0, 1.5, 6.0),
    revolute=(True, True, True),
) -> Robot:
    """Three joints that can be told apart by their limits."""
    n = len(ARM)
    chain = Chain(
        joints=ARM,
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        translation=np.zeros((n, 3)),
        axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        revolute=np.array(revolute),
        inertial=np.zeros((n, 10)),
        gravity=np.zeros(3),
        armature=np.zeros(n),
    )
    return Robot(
        name="arm",
        chain=chain,
        q_min=np.array(q_min),
        q_max=np.array(q_max),
        v_max=np.full(n, np.inf),
        tau_max=np.array([100.0, 50.0, 0.0]),
        damping=np.zeros(n),
        frictionloss=np.zeros(n),
    )


def log(**change) -> Recording:
    """Ten seconds in which each joint uses most of its range."""
    rng = np.random.default_rng(0)
    t = np.arange(1000) / 100
    q = np.array([2.5, 1.2, 5.0]) * np.sin(np.outer(t, [1.0, 1.3, 1.7]))
    tau = 20 * np.cos(np.outer(t, [1.0, 1.3, 1.7])) + rng.standard_normal(q.shape)
    fields = {"t": t, "q": q, "tau": tau, "source": "log.csv"}
    return Recording(**(fields | change))


def check_recording(recording: Recording, arm: Robot) -> Recording:
    """The log as a verb takes it, in one piece."""
    (checked,) = check_recordings([recording], arm)
    return checked


def refused(path: Path, content: str | bytes, **options) -> str:
    """The message with which a file is refused."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecordingError) as error, warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        read(path, **options)
    message = str(error.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def changed(column: int, row: int, cell: str) -> str:
    lines = [line.split(",") for line in GOOD.split()]
    lines[row][column] = cell
    return "\n".join(",".join(line) for line in lines)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(2, 3, "x1"), "q2, row 3 (data rows count from 1): 'x1' is not a num"),
        (changed(2, 3, "1_0"), "q2, row 3 (data rows count from 1): '1_0' is not a"),
        (changed(2, 2, ""), "q2 (joint_2), row 2 (data rows count from 1): value nan"),
        (changed(4, 2, "nan"), "tau2 (joint_2), row 2 (data rows count from 1): value"),
        (changed(3, 1, "inf"), "tau1 (joint_1), row 1 (data rows count from 1): value"),
        (changed(0, 3, "0.1"), "t, row 3 (data rows count from 1): time 0.1 s is rep"),
        (changed(0, 3, "0.05"), "t, row 3 (data rows count from 1): time 0.05 s goes"),
        (changed(0, 3, "late"), "time, row 3 (data rows count from 1): 'late' is not"),
        (GOOD + "0.3,1\n", "row 4 (data rows count from 1) has 2 cells; valid are 5"),
        (GOOD + "0.3,1,2,3,4,5\n", "row 4 (data rows count from 1) has 6 cells"),
        ("", "is empty"),
        ("\n\n", "empty first line"),
        ("time,q1,q2,tau1,tau2\n", "no rows below the column names"),
        ("time,q1,q2,tau1,tau2\n0,1,2,3,4\n", "two rows or more"),
        ("0,1,2,3,4\n0.1,1,2,3,4\n", "the first line holds numbers"),
        (GOOD.encode("utf-16"), "not UTF-8 text (UTF-16 or binary)"),
        (GOOD.encode("utf-16-le"), "not UTF-8 text (UTF-16 or binary)"),
        (GOOD.replace("q2", "q_höhe").encode("latin-1"), "not UTF-8 (byte 0xf6)"),
        (changed(2, 3, "ö").encode("latin-1"), "q2, row 3 (data rows count from 1)"),
        (b"\x89PNG\r\n\x1a\n\0\0", "not UTF-8"),
        (GOOD.replace("time", "clock"), "no column of time among clock, q1"),
        (GOOD.replace("q2", "t"), "more than one column of time"),
        (GOOD.replace("time", "time_A"), "no column of time among time_A"),
        (GOOD.replace("q2", "q2 [Nm]"), "column 'q2 [Nm]' is in Nm; valid are rad and"),
        (GOOD.replace("tau2", "tau2 (mA)"), "column 'tau2 (mA)' is in mA; valid are"),
        (GOOD.replace("q2", "q2 [rpm]"), "column 'q2 [rpm]' is in rpm; valid are rad"),
        (
            GOOD.replace("\n", "\r"),
            "lines end in CR alone; valid are LF, and CR with LF",
        ),
        (changed(2, 2, '"1'), "row 2 (data rows count from 1) has"),
        (changed(2, 1, "1\r2"), "row 1 (data rows count from 1) has 3 cells"),
        (GOOD.replace("tau", "load"), "no torques among the columns time, q1"),
        (GOOD.replace("tau", "load"), "torque=False reads a log without"),
        (GOOD.replace("q", "x"), "no positions among the columns time, x1"),
        (GOOD.replace("tau2", "tau1"), "'tau1' and 'tau1' are both tau of joint_1"),
        (GOOD.replace("q2", "q_1"), "'q1' and 'q_1' are both q of joint_1"),
        (GOOD.replace("tau2", "note"), "missing joints: joint_2; valid are joint_1"),
        (GOOD.replace("q2", "q3"), "missing joints: joint_2; unknown joints: number 3"),
    ],
)
def test_bad_csv_is_refused_with_file_column_and_row(tmp_path, content, message):
    assert message in refused(tmp_path / "log.csv", content)


def test_rows_are_counted_past_the_first_block_of_a_long_file(tmp_path):
    rows = [f"{k},{k},{k}" for k in range(200_000)]
    rows[150_000] = "150000,oops,1"
    message = refused(tmp_path / "log.csv", "\n".join(["t,q1,tau1", *rows]))
    assert "q1, row 150001 (data rows count from 1): 'oops'" in message


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ("shoulder", "elbow"),
            "missing joints: wrist; valid are shoulder, elbow, wri",
        ),
        (("shoulder", "elbow", "hand"), "missing joints: wrist; unknown joints: hand;"),
    ],
)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_and_extra_joints_are_listed(tmp_path, suffix, names, message):
    x = np.random.default_rng(0).standard_normal((9, len(names)))
    path = tmp_path / f"log{suffix}"
    write(Recording(t=np.arange(9) / 10, q=x, tau=x, joints=names), path)
    with pytest.raises(RecordingError, match=f"log{suffix}: .*{message}"):
        read(path, joints=ARM)


def test_another_number_of_numbered_joints_is_listed(tmp_path):
    told = refused(tmp_path / "a.csv", GOOD, joints=ARM)
    assert "missing joints: wrist" in told and told.endswith(
        "an arm without them: --joints"
    )
    message = refused(tmp_path / "b.csv", GOOD, joints=("hinge",))
    assert "unknown joints: number 2; valid are hinge" in message


@pytest.mark.parametrize("suffix", [".parquet", ".npz"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path, suffix, share):
    write(log(), tmp_path / f"log{suffix}")
    content = (tmp_path / f"log{suffix}").read_bytes()
    message = refused(tmp_path / f"cut{suffix}", content[: int(share * len(content))])
    assert "truncated?" in message


@pytest.mark.parametrize("suffix", [".parquet", ".npz"])
def test_files_of_another_kind_are_refused(tmp_path, suffix):
    assert "truncated?" in refused(tmp_path / f"log{suffix}", GOOD)


@pytest.mark.parametrize("suffix", [".parquet", ".npz"])
def test_damaged_files_never_end_in_a_traceback(tmp_path, suffix):
    write(log(), tmp_path / f"log{suffix}")
    content = bytearray((tmp_path / f"log{suffix}").read_bytes())
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(content), 60):
        damaged = content.copy()
        damaged[place] ^= 0xFF
        path = tmp_path / f"bad{suffix}"
        path.write_bytes(damaged)
        try:
            read(path)
        except RecordingError as error:
            assert str(path) in str(error)
        except HybridWarning:
            pass


def test_parquet_names_column_and_row(tmp_path):
    table = {"t": [0.0, 0.1], "q1": [1.0, None], "tau1": [1.0, 2.0]}
    parquet.write_table(pa.table(table), tmp_path / "log.parquet")
    with pytest.raises(RecordingError, match=r"log.parquet: q1 \(joint_1\), row 2"):
        read(tmp_path / "log.parquet")
    parquet.write_table(pa.table(table | {"q1": ["a", "b"]}), tmp_path / "log.parquet")
    with pytest.raises(
        RecordingError, match="q1 has shape .2,. and type .* valid are num"
    ):
        read(tmp_path / "log.parquet")
    empty = {name: pa.array([], pa.float64()) for name in table}
    parquet.write_table(pa.table(empty), tmp_path / "log.parquet")
    with pytest.raises(RecordingError, match="two rows or more"):
        read(tmp_path / "log.parquet")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.array([[object()]] * 3)}, "not a whole NPZ file of plain arrays"),
        ({"q": np.array([["a"]] * 3)}, "q has shape .* valid are numbers"),
        ({"q": np.ones((3, 2, 2))}, "q has shape"),
        ({"q": np.ones((4, 2))}, "q1 .joint_1. has 4 rows; valid are 3"),
        ({"tau": np.ones((3, 1))}, "missing joints: joint_2"),
        ({"joints": ARM}, "q: 2 columns; valid are 3, one for each of joints sho"),
        ({"t": np.ones((3, 2))}, "t has shape .* valid are numbers"),
        ({"t": np.array(1.0)}, "t has shape .* valid are numbers"),
    ],
)
def test_npz_of_wrong_arrays_is_refused(tmp_path, change, message):
    fields = {"t": np.arange(3) / 10, "q": np.ones((3, 2)), "tau": np.ones((3, 2))}
    np.savez(tmp_path / "log.npz", **(fields | change))
    with pytest.raises(RecordingError, match=f"log.npz: .*{message}"):
        read(tmp_path / "log.npz")


def test_a_single_array_is_no_recording(tmp_path):
    with (tmp_path / "log.npz").open("wb") as file:
        np.save(file, np.ones(3))
    with pytest.raises(RecordingError, match="log.npz: a single array"):
        read(tmp_path / "log.npz")


def test_paths_without_recordings_say_what_is_valid(tmp_path):
    for path in (tmp_path, tmp_path / "none.csv", tmp_path / "*.csv"):
        with pytest.raises(
            RecordingError, match="no recordings there; valid are files"
        ):
            read_all([path])
    with pytest.raises(RecordingError, match="no paths given"):
        read_all([])
    with pytest.raises(RecordingError, match="no such file"):
        read(tmp_path / "none.csv")
    with pytest.raises(RecordingError, match="unknown kind .* valid are .csv, .tsv"):
        read(tmp_path / "log.pkl")
    with pytest.raises(RecordingError, match="unknown kind .* valid are .csv, .parq"):
        write(log(), tmp_path / "log.mat")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milli"), (1e6, "micro")])
def test_time_in_other_units_is_refused(factor, unit):
    with pytest.raises(
        RecordingError, match=f"median step is .* in {unit}seconds; valid are seconds"
    ):
        check_recording(log(t=log().t * factor), robot())


def test_numbers_beyond_any_arm_are_refused():
    for channel in ("q", "tau"):
        x = log().channels[channel].copy()
        x[7, 1] = 1e300
        with pytest.raises(
            RecordingError, match=rf"{channel}2 \(elbow\), row 8 .*: 1e\+300; valid are"
        ):
            check_recording(log(**{channel: x}), robot())
    with pytest.raises(RecordingError, match=r"t: 1e\+300 s; valid are times"):
        check_recording(log(t=log().t / log().t[-1] * 1e300), robot())
    with pytest.raises(RecordingError, match=r"tau2 \(elbow\) is constant"):
        check_recording(log(tau=log().tau * [1, 1e-310, 1]), robot())


def test_positions_in_milliradians_are_refused():
    with pytest.raises(RecordingError, match="looks like milliradians; valid are rad"):
        check_recording(log(q=log().q * 1e3), robot())


def test_joints_faster_than_any_drive_are_refused():
    with pytest.raises(RecordingError, match=r"moves at .* rad/s.*; valid are speeds"):
        check_recording(log(t=log().t * 0.2), replace_speed(robot()))


def replace_speed(arm: Robot) -> Robot:
    """The arm with a limit of speed."""
    return replace(arm, v_max=np.full(arm.size, 0.5))


@pytest.mark.parametrize("member", ["q", "unused"])
def test_npz_that_asks_for_more_than_it_holds_is_refused(tmp_path, member):
    fields = {"t": np.arange(3) / 10, "q": np.ones((3, 2)), "tau": np.ones((3, 2))}
    np.savez(tmp_path / "log.npz", **fields, unused=np.ones(3))
    with zipfile.ZipFile(tmp_path / "log.npz") as whole:
        parts = {name: whole.read(name) for name in whole.namelist()}
    for shape in ("(10000000000000000, 2)", "(" + "9" * 4000 + ", 2)"):
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n"
        start = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header))
        with zipfile.ZipFile(tmp_path / "bad.npz", "w") as bad:
            for name, content in parts.items():
                huge = start + header.encode() + content[128:]
                bad.writestr(name, huge if name == f"{member}.npy" else content)
        with pytest.raises(RecordingError, match="not a whole NPZ file") as error:
            read(tmp_path / "bad.npz")
        assert "\n" not in str(error.value)


def test_what_no_channel_needs_is_not_unpacked(tmp_path, monkeypatch):
    """A member of zeros unpacks to a thousand times what it takes."""
    fields = {"t": np.arange(3) / 10, "q": np.ones((3, 2)), "tau": np.ones((3, 2))}
    np.savez_compressed(tmp_path / "log.npz", **fields, more=np.zeros((10**6, 3)))
    tracemalloc.start()
    with pytest.warns(HybridWarning, match="ignored columns"):
        assert read(tmp_path / "log.npz").q.shape == (3, 2)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4e6


def test_an_archive_that_unpacks_to_more_than_any_log_is_refused(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, t=np.arange(3) / 10, q=np.ones((3, 2)), tau=np.ones((3, 2)))
    content = bytearray(path.read_bytes())
    at = content.index(b"PK\x01\x02")  # the central directory says how large
    content[at + 24 : at + 28] = struct.pack("<I", (1 << 32) - 2)
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="429496.* bytes, unpacked; valid are"):
        read(path)


def test_a_good_recording_passes_without_a_word():
    checked = check_recording(log(), robot())
    assert checked.joints == ARM
    assert np.array_equal(checked.q, log().q)


def test_joints_in_the_robots_names_are_put_in_the_robots_order():
    turned = log(joints=ARM).in_order(("wrist", "shoulder", "elbow"))
    assert check_recording(turned, robot()) == log(joints=ARM)


def test_numbered_joints_in_another_order_are_told_by_their_limits():
    order = [2, 0, 1]
    wrong = log(q=log().q[:, order], tau=log().tau[:, order])
    with pytest.raises(
        RecordingError,
        match=r"q1 \(shoulder\), row \d+ .* outside the limits -3 to 3, but all "
        "positions fit if the columns are in the order wrist, shoulder, elbow; valid",
    ):
        check_recording(wrong, robot())


@pytest.mark.parametrize("limit", [3.0, np.inf])
def test_degrees_are_told_from_radians(limit):
    arm = robot(q_min=(-3.0, -1.5, -limit), q_max=(3.0, 1.5, limit))
    degrees = log(q=np.rad2deg(log().q * [1, 1, 0.5]))
    message = r"log.csv: q\d \(\w+\), row \d+ .* looks like degrees; valid are rad"
    with pytest.raises(RecordingError, match=message):
        check_recording(degrees, arm)


def test_degrees_of_one_joint_without_limits_are_told_from_radians():
    arm = robot(q_min=(-np.inf,) * 3, q_max=(np.inf,) * 3)
    with pytest.raises(RecordingError, match="looks like degrees"):
        check_recording(log(q=log().q * [0.1, 30.0, 0.1]), arm)
    check_recording(log(q=log().q * [0.1, 2.0, 0.1]), arm)


def test_millimetres_of_a_linear_joint_are_told_from_metres():
    arm = robot(revolute=(True, True, False), q_min=(-3, -1.5, 0), q_max=(3, 1.5, 0.4))
    metres = np.clip(log().q * [1, 1, 0.06], 0, None) + [0, 0, 0]
    metres[:, :2] = log().q[:, :2]
    with pytest.raises(RecordingError, match=r"q3 \(wrist\).*looks like millimetres"):
        check_recording(log(q=metres * [1, 1, 1000]), arm)


def test_positions_just_outside_the_limits_are_warned_of():
    with pytest.warns(HybridWarning, match=r"q3 \(wrist\), row \d+ .*: 7 is outside"):
        check_recording(log(q=log().q * [1, 1, 1.4]), robot())


def test_torque_far_above_the_rating_is_warned_of():
    with pytest.warns(HybridWarning, match=r"tau2 \(elbow\) .* of 50\): in milliamps"):
        check_recording(log(tau=log().tau * [1, 40, 1000]), robot())


def test_a_dead_position_is_warned_of_and_a_dead_torque_refused():
    with pytest.warns(HybridWarning, match=r"log.csv: q2 \(elbow\) is constant"):
        check_recording(log(q=log().q * [1, 0, 1]), robot())
    with pytest.raises(RecordingError, match=r"log.csv: tau2 \(elbow\) is constant"):
        check_recording(log(tau=log().tau * [1, 0, 1]), robot())
    with pytest.warns(HybridWarning, match=r"v2 \(elbow\) is constant while the joint"):
        speed = np.gradient(log().q, 0.01, axis=0)
        check_recording(log(v=speed * [1, 0, 1]), robot())


def test_a_joint_that_is_told_to_rest_rests():
    q = log().q * [1, 0, 1]
    assert check_recording(log(q=q, command=q), robot()).command is not None


def test_an_arm_at_standstill_is_refused():
    with pytest.raises(RecordingError, match="log.csv: q: no joint moves more than"):
        check_recording(log(q=log().q * 1e-5), robot())


def test_frozen_channels_are_warned_of_by_row():
    tau = log().tau.copy()
    tau[300:450, 1] = tau[300, 1]
    with pytest.warns(HybridWarning, match=r"tau2 .elbow., row 301 .* 150 samples"):
        check_recording(log(tau=tau), robot())
    q = log().q.copy()
    q[300:350, 0] = q[300, 0]
    with pytest.warns(HybridWarning, match=r"q1 .shoulder., row 301 .* for 50 samples"):
        check_recording(log(q=q), robot())


def test_a_log_that_repeats_its_rows_is_warned_of():
    q, tau = log().q.copy(), log().tau.copy()
    q[500:515], tau[500:515] = q[500], tau[500]
    with pytest.warns(HybridWarning, match=r"all channels repeat for 15 .* row 501 "):
        check_recording(log(q=q, tau=tau), robot())


def test_a_saturated_torque_is_warned_of():
    tau = np.clip(log().tau, -1e3, 18.0)
    with pytest.warns(HybridWarning) as warned:
        check_recording(log(tau=tau), robot())
    assert "log.csv: tau1 (shoulder) stays at 18 for" in str(warned[0].message)
    assert "saturated?" in str(warned[0].message)


def test_short_recordings_are_refused():
    for keep in (slice(0, 90), slice(0, 1000)):
        squeeze = 1.0 if keep.stop == 90 else 0.05
        fields = {"t": log().t[keep] * squeeze, "q": log().q[keep]}
        with pytest.raises(
            RecordingError, match="log.csv: too short: .* valid are 100"
        ):
            check_recording(log(tau=log().tau[keep], **fields), robot())


def test_an_irregular_clock_is_resampled_with_a_warning():
    t = log().t + 0.002 * np.sin(np.arange(1000))
    with pytest.warns(HybridWarning, match="log.csv: irregular clock"):
        checked = check_recording(log(t=t), robot())
    assert np.ptp(np.diff(checked.t)) < 1e-9


@pytest.mark.parametrize(
    "folder", ["ur10_salerno", "kr300_kaiserslautern", "tx40_figaroh"]
)
def test_real_logs_pass(folder):
    if not (DATA / folder).is_dir():
        pytest.skip(f"the real logs are not here: no {DATA / folder}")
    arm = Robot.load(DATA / folder / "robot.urdf")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for recording in read_all(DATA / folder, joints=arm.joints):
            checked = check_recording(recording, arm)
            assert checked.joints == arm.joints
            assert checked == recording
    for warning in caught:
        message = str(warning.message)
        assert "ignored columns: " in message or "torque above 10 times" in message


WRONG = {
    "identify": lambda arm, log, fit: identify("arm.urdf", [log]),
    "diagnose": lambda arm, log, fit: diagnose("arm.urdf", [log]),
    "simulate": lambda arm, log, fit: simulate("arm.urdf"),
    "inspect_recording": lambda arm, log, fit: inspect_recording(log, "arm.urdf"),
    "fit_servo": lambda arm, log, fit: fit_servo("arm.urdf", [log]),
    "calibrate": lambda arm, log, fit: calibrate("arm.urdf", "poses.csv"),
}


@pytest.mark.parametrize("verb", WRONG)
def test_a_file_in_place_of_a_robot_is_told_how_to_load_one(verb):
    with pytest.raises(
        HybridError, match=r"robot is 'arm.urdf'; valid is .*Robot.load\("
    ):
        WRONG[verb](Robot.load("planar"), planar_log(), None)


@pytest.mark.parametrize("given", ["logs", ["a.csv"], Path("logs"), None, 3, np.eye(2)])
@pytest.mark.parametrize("verb", [identify, diagnose, fit_servo])
def test_files_in_place_of_recordings_are_told_how_to_read_them(verb, given):
    with pytest.raises(
        HybridError, match="recordings is .*; valid is .*read_recordings"
    ):
        verb(Robot.load("planar"), given)


def test_a_fit_in_place_of_its_model_is_told_where_the_model_is(tmp_path):
    arm, log = Robot.load("planar"), planar_log()
    fit = identify(arm, log, stages=("rigid",))
    for verb in (
        lambda: predict(fit, log),
        lambda: validate(fit, [log]),
        lambda: export(fit, tmp_path, format="c"),
        lambda: OnlineIdentifier.from_model(fit, rate=500.0),
    ):
        with pytest.raises(HybridError, match="model is a Fit; valid is .*fit.model"):
            verb()


def test_one_recording_is_a_list_of_one():
    arm, log = Robot.load("planar"), planar_log()
    alone, listed = (identify(arm, x, stages=("rigid",)) for x in (log, [log]))
    np.testing.assert_array_equal(alone.estimate.theta, listed.estimate.theta)


@cache
def planar_log() -> Recording:
    return simulate(Robot.load("planar"), trajectories=1, duration=5.0)[0]


@pytest.mark.parametrize("verb", [simulate, identify])
def test_names_in_place_of_effects_are_refused_with_the_way_to_make_effects(verb):
    arm = Robot.load("planar")
    given = [] if verb is simulate else [[]]
    with pytest.raises(HybridError, match="elbow'.*; valid is .*effects_from"):
        verb(arm, *given, effects=["stribeck:elbow"])


@pytest.mark.parametrize("given", [3, "ab"])
def test_names_of_joints_are_a_list_of_names(given):
    t, q = np.arange(9) / 100.0, np.zeros((9, 2))
    with pytest.raises(HybridError, match="joints is .*; valid are names"):
        Recording(t, q, joints=given)


def test_what_is_no_sample_is_refused_before_it_changes_anything():
    tracked = OnlineIdentifier(Robot.load("planar"), rate=100.0)
    with pytest.raises(HybridError, match="of type ndarray; valid is a Sample"):
        tracked.update(np.zeros(2))
