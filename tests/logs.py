"""One true recording, written in the formats and dialects that users have."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import scipy.io
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hybrid.recording import Recording

ARM = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
ALPHABETICAL = tuple(sorted(ARM))
START = 1_700_000_000_000_000_000  # ns since 1970
CONSTANT = 0.125  # N·m/A
STATE = "sensor_msgs/msg/JointState"
CONTROL = "control_msgs/msg/JointTrajectoryControllerState"
PLAN = "trajectory_msgs/msg/JointTrajectory"


def truth(samples: int = 150) -> Recording:
    """Two dozen signals that no two columns share."""
    t = np.arange(samples) / 125
    k = np.arange(6)
    q = np.sin(np.outer(t, 1 + k / 7)) + k / 3
    return Recording(
        t=t, q=q, v=np.cos(np.outer(t, 2 + k / 5)), tau=5 * np.sin(q) + k,
        command=q + 0.01 * np.cos(np.outer(t, 3 + k)), joints=ARM,
    )  # fmt: skip


def columns(
    log: Recording, label: Callable[[str, int, str], str], order=ARM, **factors: float
) -> dict[str, np.ndarray]:
    """Columns of all channels, under labels of channel, number from 0, and joint."""
    return {
        label(channel, k, joint): x[:, log.joints.index(joint)]
        * factors.get(channel, 1)
        for channel, x in log.channels.items()
        for k, joint in enumerate(order)
    }


def csv(path: Path, table: dict, time: str = "time", sep: str = ",", t=None) -> Path:
    """Write a table as text, gzipped if the name says so."""
    log = truth()
    table = {time: log.t if t is None else t} | table
    text = pd.DataFrame(table).to_csv(index=False, sep=sep)
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


def worded(**words: str) -> Callable[[str, int, str], str]:
    """Labels by a pattern for each channel, with n, n1 and joint."""
    return lambda channel, n, joint: words[channel].format(n=n, n1=n + 1, joint=joint)


RTDE = worded(q="actual_q_{n}", v="actual_qd_{n}", tau="actual_current_{n}",
              command="target_q_{n}")  # fmt: skip
FRANKA = worded(q="q[{n}]", v="dq[{n}]", tau="tau_J[{n}]", command="q_d[{n}]")
DIALECTS = {
    "hybrid": worded(q="q{n1}", v="v{n1}", tau="tau{n1}", command="command{n1}"),
    "named": worded(q="q_{joint}", v="v_{joint}", tau="tau_{joint}",
                    command="command_{joint}"),
    "counted": worded(q="joint{n1}_pos", v="joint{n1}_vel", tau="joint{n1}_torque",
                      command="joint{n1}_pos_cmd"),
    "position": worded(q="{joint}_position", v="{joint}_velocity",
                       tau="{joint}_effort", command="{joint}_position_target"),
    "dotted": worded(q="{joint}.pos", v="{joint}.vel", tau="{joint}.torque",
                     command="{joint}.cmd"),
    "brackets": worded(q="position[{n}]", v="velocity[{n}]", tau="effort[{n}]",
                       command="reference[{n}]"),
    "path": worded(q="position/{joint}", v="velocity/{joint}", tau="effort/{joint}",
                   command="command/{joint}"),
    "plotjuggler": worded(q="/joint_states/{joint}/position",
                          v="/joint_states/{joint}/velocity",
                          tau="/joint_states/{joint}/effort",
                          command="/joint_states/{joint}/command"),
    "array": worded(q="/ns/joint_states/position[{n}]",
                    v="/ns/joint_states/velocity[{n}]",
                    tau="/ns/joint_states/effort[{n}]",
                    command="/ns/joint_states/reference/position[{n}]"),
    "measured": worded(q="measured_joint_position_{n1}", v="measured_speed_{n1}",
                       tau="measured_torque_{n1}", command="desired_position_{n1}"),
    "units": worded(q="q{n1} [rad]", v="dq{n1} (rad/s)", tau="tau{n1} [N m]",
                    command="q_ref{n1} [rad]"),
    "suffix": worded(q="q{n1}_rad", v="dq{n1}_rad_s", tau="tau{n1}_Nm",
                     command="q_cmd{n1}_rad"),
}  # fmt: skip


def text_files(folder: Path) -> dict[str, tuple[Path, dict]]:
    """Text files: name -> path, and what read needs beside it."""
    log, found = truth(), {}
    for name, label in DIALECTS.items():
        time = "__time" if name == "plotjuggler" else "time"
        order = ALPHABETICAL if "{joint}" in label("q", 0, "{joint}") else ARM
        path = csv(folder / f"{name}.csv", columns(log, label, order), time)
        found[name] = (path, {})
    plain = columns(log, DIALECTS["hybrid"])
    found["gzip"] = (csv(folder / "log.csv.gz", plain), {})
    found["tab"] = (csv(folder / "log.tsv", plain, sep="\t"), {})
    degrees = worded(q="q{n1} [deg]", v="dq{n1} [rpm]", tau="tau{n1} [mNm]",
                     command="qref{n1}_deg")  # fmt: skip
    found["other units"] = (
        csv(
            folder / "deg.csv",
            columns(log, degrees, q=180 / np.pi, v=30 / np.pi, tau=1e3,
                    command=180 / np.pi),
            "time_ms", t=log.t * 1e3,
        ), {},
    )  # fmt: skip
    found["ur_rtde"] = (
        csv(folder / "rtde.csv", columns(log, RTDE, tau=1 / CONSTANT / 100),
            "timestamp"),
        {"map": {"tau": {"torque_constant": CONSTANT, "gear_ratio": [100] * 6}}},
    )  # fmt: skip
    spaced = csv(folder / "spaced.csv", columns(log, RTDE, tau=1 / CONSTANT),
                 "timestamp", sep=" ")  # fmt: skip
    found["ur_rtde, spaces"] = (spaced, {"map": {"tau": {"torque_constant": CONSTANT}}})
    echo = worded(q="field.position{n}", v="field.velocity{n}", tau="field.effort{n}",
                  command="field.reference_{joint}")  # fmt: skip
    names = {f"field.name{k}": [x] * len(log.t) for k, x in enumerate(ALPHABETICAL)}
    stamps = START + np.round(log.t * 1e9).astype(np.int64)
    echoed = names | columns(log, echo, ALPHABETICAL)
    found["rostopic echo"] = (csv(folder / "echo.csv", echoed, "%time", t=stamps), {})
    more = {f"tau_ext_hat_filtered[{k}]": log.t for k in range(6)}
    more |= {f"dtau_J[{k}]": log.t for k in range(6)}
    found["libfranka"] = (
        csv(folder / "franka.csv", columns(log, FRANKA) | more, "duration",
            t=log.t * 1e3), {},
    )  # fmt: skip
    dates = pd.to_datetime(START + np.round(log.t * 1e9).astype(np.int64))
    named = columns(log, DIALECTS["named"], ALPHABETICAL)
    pd.DataFrame(named, index=dates).to_csv(folder / "pandas.csv")
    found["pandas index"] = (folder / "pandas.csv", {})
    found["nanoseconds"] = (
        csv(folder / "ns.csv", named, "timestamp_ns", t=stamps), {}
    )  # fmt: skip
    found["bare stamps"] = (csv(folder / "s.csv", named, "timestamp", t=stamps), {})
    grip = {"q_gripper": log.t, "tau_gripper": log.t, "v_gripper": log.t}
    found["gripper"] = (csv(folder / "gripper.csv", named | grip), {})
    odd = {f"m{k}": log.q[:, k] for k in range(6)} | {
        f"i{k}": log.tau[:, k] * 1e3 / CONSTANT for k in range(6)}  # fmt: skip
    odd |= {f"w{k}": log.v[:, k] for k in range(6)}
    odd |= {f"c{k}": log.command[:, k] for k in range(6)}
    mapped = {
        "time": {"column": "clk", "unit": "ms"},
        "q": "m{}",
        "v": [f"w{k}" for k in range(6)],
        "command": {joint: f"c{k}" for k, joint in enumerate(ARM)},
        "tau": {"columns": "i{}", "unit": "mA", "torque_constant": CONSTANT},
    }
    found["map"] = (csv(folder / "odd.csv", odd, "clk", t=log.t * 1e3), {"map": mapped})
    return found


def table_files(folder: Path) -> dict[str, tuple[Path, dict]]:
    """Parquet, NumPy, HDF5 and MATLAB files."""
    log, found = truth(), {}
    named = columns(log, DIALECTS["named"], ALPHABETICAL)
    dates = pd.to_datetime(START + np.round(log.t * 1e9).astype(np.int64))
    pd.DataFrame(named, index=dates).to_parquet(folder / "pandas.parquet")
    found["pandas parquet"] = (folder / "pandas.parquet", {})
    pl.DataFrame({"time": log.t} | named).write_parquet(folder / "polars.parquet")
    found["polars parquet"] = (folder / "polars.parquet", {})
    lists = {"time": log.t} | {k: list(x) for k, x in log.channels.items()}
    parquet.write_table(pa.table(lists), folder / "lists.parquet")
    found["lists"] = (folder / "lists.parquet", {})
    at = [ARM.index(x) for x in ALPHABETICAL]
    words = {"q": "position", "v": "velocity", "tau": "effort"}
    lists = {"time": log.t, "name": [ALPHABETICAL] * len(log.t)}
    lists |= {word: list(log.channels[k][:, at]) for k, word in words.items()}
    lists |= {f"command_{joint}": log.command[:, k] for k, joint in enumerate(ARM)}
    parquet.write_table(pa.table(lists), folder / "names.parquet")
    found["lists beside names"] = (folder / "names.parquet", {})
    np.savez(folder / "log.npz", t=log.t, **log.channels)
    found["npz"] = (folder / "log.npz", {})
    np.savez_compressed(folder / "n.npz", t=log.t, joints=ARM, **log.channels)
    found["npz of names"] = (folder / "n.npz", {})
    with h5py.File(folder / "flat.h5", "w") as file:
        file["time"] = log.t * 1e3
        file["time"].attrs["units"] = "ms"
        file.create_dataset("joints", data=[x.encode() for x in ARM])
        for name, x in log.channels.items():
            file[f"robot/{name}"] = x
    found["hdf5"] = (folder / "flat.h5", {})
    with h5py.File(folder / "demo.hdf5", "w") as file:
        demo = file.create_group("data/demo_0/obs")
        args = json.dumps({"env_kwargs": {"control_freq": 125}})
        file["data"].attrs["env_args"] = args
        demo["robot0_joint_pos"], demo["robot0_joint_vel"] = log.q, log.v
        demo["robot0_joint_torque"] = log.tau
        demo["robot0_joint_pos_cos"] = np.cos(log.q)
        demo["robot0_eef_pos"] = log.q[:, :3]
        file["data/demo_0/actions"] = log.command
    mapped = {"command": [f"actions[{k}]" for k in range(1, 7)]}
    found["robomimic"] = (folder / "demo.hdf5", {"map": mapped})
    arrays = {"t": log.t} | log.channels
    scipy.io.savemat(folder / "v5.mat", arrays, do_compression=True)
    found["mat"] = (folder / "v5.mat", {})
    turned = {name: x.T for name, x in arrays.items()}
    scipy.io.savemat(folder / "struct.mat", {"log": turned})
    found["mat struct"] = (folder / "struct.mat", {})
    with h5py.File(folder / "v73.mat", "w", userblock_size=512) as file:
        for name, x in arrays.items():
            file[name] = np.atleast_2d(x).T if x.ndim == 1 else x.T
    with (folder / "v73.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    found["mat 7.3"] = (folder / "v73.mat", {})
    return found


def lerobot(folder: Path, version: str, episodes: int = 1) -> Path:
    """A dataset as LeRobot lays it out, with a gripper."""
    log = truth()
    names = [f"{joint}.pos" for joint in (*ARM, "gripper")]
    feature = {"dtype": "float32", "shape": [7], "names": names}
    if version == "v2.1":
        feature["names"] = {"motors": [n.removesuffix(".pos") for n in names]}
    info = {"codebase_version": version, "fps": 125, "robot_type": "x", "features": {
        "observation.state": feature, "action": feature}}  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    tables = []
    for k in range(episodes):
        state, action = (np.column_stack([x, log.t]) for x in (log.q, log.command))
        tables.append(pa.table({
            "observation.state": list(state), "action": list(action),
            "timestamp": log.t, "episode_index": np.full(len(log.t), k),
            "frame_index": np.arange(len(log.t)),
        }))  # fmt: skip
    if version == "v2.1":
        for k, table in enumerate(tables):
            parquet.write_table(table, chunk / f"episode_{k:06d}.parquet")
    else:
        parquet.write_table(pa.concat_tables(tables), chunk / "file-000.parquet")
    return folder


CONTROL_TEXT = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
string[] multi_dof_joint_names
"""


DYNAMIC = "control_msgs/msg/DynamicJointState"
DYNAMIC_TEXT = """std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
"""
INTERFACE = "control_msgs/msg/InterfaceValue"
INTERFACE_TEXT = "string[] interface_names\nfloat64[] values\n"


@cache
def store(ros1: bool = False):
    """Message types of a distribution, with one of control_msgs."""
    found = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    found.register(get_types_from_msg(CONTROL_TEXT, CONTROL))
    found.register(get_types_from_msg(INTERFACE_TEXT, INTERFACE))
    found.register(get_types_from_msg(DYNAMIC_TEXT, DYNAMIC))
    return found


class Messages:
    """Makes messages of one type store."""

    def __init__(self, ros1: bool = False) -> None:
        self.store, self.ros1 = store(ros1), ros1
        self.types = self.store.types

    def header(self, stamp: int):
        time = self.types["builtin_interfaces/msg/Time"]
        seq = {"seq": stamp % 1000} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](
            stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="", **seq
        )

    def state(self, stamp: int, names, q, v, tau):
        return self.types[STATE](
            header=self.header(stamp), name=list(names), position=np.array(q),
            velocity=np.array(v), effort=np.array(tau),
        )  # fmt: skip

    def point(self, q=(), v=(), after: int = 0):
        duration = self.types["builtin_interfaces/msg/Duration"]
        none = np.zeros(0)
        return self.types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array(q, dtype=float), velocities=np.array(v, dtype=float),
            accelerations=none, effort=none,
            time_from_start=duration(sec=after // 10**9, nanosec=after % 10**9),
        )  # fmt: skip

    def control(self, stamp: int, names, reference, q):
        return self.types[CONTROL](
            header=self.header(stamp), joint_names=list(names),
            reference=self.point(reference), feedback=self.point(q),
            error=self.point(np.subtract(reference, q)), output=self.point(),
            multi_dof_joint_names=[],
        )  # fmt: skip

    def dynamic(self, stamp: int, names, rows):
        value = self.types[INTERFACE]
        words = ["position", "velocity", "effort"]
        return self.types[DYNAMIC](
            header=self.header(stamp), joint_names=list(names),
            interface_values=[value(words, np.array(row)) for row in rows],
        )  # fmt: skip

    def plan(self, stamp: int, names, points):
        return self.types[PLAN](
            header=self.header(stamp), joint_names=list(names), points=points
        )

    def raw(self, message) -> bytes:
        kind = message.__msgtype__
        if self.ros1:
            return bytes(self.store.serialize_ros1(message, kind))
        return bytes(self.store.serialize_cdr(message, kind))


def bag(
    path: Path,
    content: list[tuple[str, int, object]],
    messages: Messages,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    packed: bool = False,
) -> Path:
    """Write messages, (topic, time, message), as a bag."""
    writer = Writer1(path) if messages.ros1 else Writer2(
        path, version=9, storage_plugin=storage)  # fmt: skip
    if packed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, stamp, message in sorted(content, key=lambda x: x[1]):
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(
                    topic, kind, typestore=messages.store
                )
            writer.write(topics[topic], stamp, messages.raw(message))
    return path


def states(
    messages: Messages, *, order=ALPHABETICAL, start: int = START, log=None
) -> list[tuple[str, int, object]]:
    """Joint states as a driver publishes them: in its own order, with late arrival."""
    log = log or truth()
    at = [ARM.index(joint) for joint in order]
    found = []
    for k, t in enumerate(log.t):
        stamp = start + round(t * 1e9)
        message = messages.state(stamp, order, log.q[k, at], log.v[k, at],
                                 log.tau[k, at])  # fmt: skip
        found.append(("/joint_states", stamp + 1000 + k % 7, message))
    return found
