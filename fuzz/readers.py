"""Every reader and loader of the package, with files that it takes: what is fuzzed."""

from __future__ import annotations

import gzip
import json
import shutil
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from hybrid.calibration.read import read_measurements
from hybrid.dynamics import stacked_base
from hybrid.effects import effects_from_text
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError
from hybrid.exports import export, read_manifest
from hybrid.files import write_json
from hybrid.identification import DynamicModel
from hybrid.model.model_file import content_digest
from hybrid.plant import load_truth
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording, read, read_all, recording_from_table, write
from hybrid.robot import Robot

MODELS = Path(__file__).parents[1] / "models"
ROBOT = Robot.load(MODELS / "planar.xml")


@dataclass(frozen=True)
class Reader:
    """What reads a kind of file.

    Attributes:
        name: Name of the file that it is given.
        read: The reader.
        seeds: Files that it takes, given a folder to make them in.
    """

    name: str
    read: Callable[[Path], object]
    seeds: Callable[[Path], Sequence[bytes]]

    def outcome(self, path: Path) -> str:
        """``taken`` or ``refused``; whatever else is raised is a finding."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.read(path)
        except HybridError as error:
            text = str(error)
            assert text and "\n" not in text, f"not one line: {text!r}"
            return "refused"
        return "taken"


def _models(*names: str) -> Callable[[Path], Sequence[bytes]]:
    return lambda _: [(MODELS / name).read_bytes() for name in names]


def _recording(suffix: str) -> Callable[[Path], Sequence[bytes]]:
    def made(folder: Path) -> Sequence[bytes]:
        x = np.random.default_rng(0).normal(size=(20, 2))
        path = folder / f"log{suffix}"
        write(Recording(t=np.arange(20) / 100, q=x, tau=x), path)
        return [path.read_bytes()]

    return made


def _small() -> Recording:
    x = np.random.default_rng(0).normal(size=(20, 2))
    return Recording(t=np.arange(20) / 100, q=x, tau=x)


def _bag(suffix: str) -> Callable[[Path], Sequence[bytes]]:
    """A bag of twenty joint states, in the format of a suffix."""

    def made(folder: Path) -> Sequence[bytes]:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_typestore

        ros1, log = suffix == ".bag", _small()
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        kind, types = "sensor_msgs/msg/JointState", store.types
        path = folder / f"made{suffix}"
        plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
        plain = Writer1(path) if ros1 else Writer2(
            path.with_suffix(""), version=9, storage_plugin=plugin)  # fmt: skip
        with plain as writer:
            topic = writer.add_connection("/joint_states", kind, typestore=store)
            for k, t in enumerate(log.t):
                at = types["builtin_interfaces/msg/Time"](sec=1, nanosec=int(t * 1e9))
                seq = {"seq": k} if ros1 else {}
                header = types["std_msgs/msg/Header"](stamp=at, frame_id="", **seq)
                message = types[kind](
                    header=header, name=["a", "b"], position=log.q[k],
                    velocity=log.q[k], effort=log.tau[k],
                )  # fmt: skip
                raw = (store.serialize_ros1 if ros1 else store.serialize_cdr)(
                    message, kind
                )
                writer.write(topic, 10**9 + k * 10**7, bytes(raw))
        if ros1:
            return [path.read_bytes()]
        return [next(path.with_suffix("").glob(f"*{suffix}")).read_bytes()]

    return made


def _hdf5(folder: Path) -> Sequence[bytes]:
    import h5py

    log = _small()
    with h5py.File(folder / "made.h5", "w") as file:
        file["t"], file["q"], file["tau"] = log.t, log.q, log.tau
        file["q"].attrs["units"] = "rad"
    return [(folder / "made.h5").read_bytes()]


def _mat(folder: Path) -> Sequence[bytes]:
    import scipy.io

    log, seeds = _small(), []
    for compressed in (True, False):
        content = {"t": log.t, "q": log.q, "tau": log.tau}
        scipy.io.savemat(folder / "made.mat", content, do_compression=compressed)
        seeds.append((folder / "made.mat").read_bytes())
    return seeds


def _gzipped(folder: Path) -> Sequence[bytes]:
    write(_small(), folder / "made.csv")
    return [gzip.compress((folder / "made.csv").read_bytes())]


def _dataset(path: Path) -> object:
    """Read a LeRobot dataset with this ``info.json``."""
    folder = path.parent / "set"
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "data").mkdir(exist_ok=True)
    (folder / "meta" / "info.json").write_bytes(path.read_bytes())
    log = _small()
    columns = {"timestamp": log.t, "episode_index": np.zeros(20, dtype=int)}
    columns |= {"observation.state": list(log.q), "action": list(log.q)}
    parquet.write_table(pa.table(columns), folder / "data" / "episode.parquet")
    try:
        return read_all(folder, torque=False)
    finally:
        shutil.rmtree(folder)


def _mapped(path: Path) -> object:
    """Read a log with labels of its own by this map."""
    log = path.parent / "mapped.csv"
    log.write_text("clk,a1,b1\n0,1,2\n1,2,3\n2,3,4\n")
    try:
        return read(log, map=path)
    finally:
        log.unlink()


INFO = (
    b'{"codebase_version": "v2.1", "fps": 100, "features": {"observation.state": '
    b'{"dtype": "float32", "shape": [2], "names": ["a.pos", "b.pos"]}, "action": '
    b'{"dtype": "float32", "shape": [2], "names": {"motors": ["a", "b"]}}}}'
)
MAP = (
    b"time: {column: clk, unit: ms}\nq: {columns: 'a{}', unit: deg}\n"
    b"tau: {columns: [b1], unit: mA, torque_constant: 0.1, gear_ratio: [100]}\n"
)


def _labels(path: Path) -> object:
    """Read a log of one row of labels, whose columns are all numbers."""
    labels = path.read_bytes().decode("utf-8", errors="replace").split(",")[:50]
    x = {label: np.arange(5.0) for label in labels}
    return recording_from_table(x)


LABELS = (
    b"__time,/joint_states/elbow/position [deg],/joint_states/elbow/effort,ddq_elbow,"
    b"q_ref_elbow_deg,tau_ext[0],elbow_temp (K)"
)


def _model() -> DynamicModel:
    base = stacked_base(ROBOT.chain, (), ())
    links = ROBOT.chain.inertial
    base = base.with_values(base.mapping @ links.ravel())
    effects = (Viscous((0,), {"coefficient": 1.0}),)
    return DynamicModel(ROBOT, base, effects, inertial=links)


def _saved(folder: Path) -> Sequence[bytes]:
    _model().save(folder / "model.json")
    return [(folder / "model.json").read_bytes()]


def _resealed(path: Path) -> object:
    """Load a model whose hash was made to fit, as one would who means harm."""
    try:
        content = json.loads(path.read_bytes())
        content["sha256"] = content_digest(
            {k: x for k, x in content.items() if k != "sha256"}
        )
        write_json(path, content)
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass  # read it as it is
    return DynamicModel.load(path)


def _exported(folder: Path) -> Sequence[bytes]:
    export(_model(), folder / "c", format="c")
    return [(folder / "c" / "manifest.json").read_bytes()]


def _effects(path: Path) -> object:
    text = path.read_bytes().decode("utf-8", errors="replace")
    return effects_from_text(text, ROBOT.joints, joint_scales(ROBOT))


POSES = b"q1,q2,x [mm],y [mm],z [mm]\n0,0.1,1,2,3\n0.2,0.3,4,5,6\n0.4,-1,7,8,9\n"
TRUTH = (
    f"robot: {MODELS / 'planar.xml'}\ninertial: [{{joint: elbow, mass: 1.1}}]\n"
    "effects: [{effect: coulomb, joints: [elbow], values: {level: 0.5}}]\n"
    "noise: {torque_std: 0.1, position_std: 1.0e-5}\nplant: {step: 0.0005}\n"
).encode()
READERS = {
    "MJCF": Reader("arm.xml", Robot.load, _models("planar.xml", "scara.xml")),
    "URDF": Reader("arm.urdf", Robot.load, _models("planar.urdf", "scara.urdf")),
    "CSV": Reader("log.csv", read, _recording(".csv")),
    "Parquet": Reader("log.parquet", read, _recording(".parquet")),
    "NPZ": Reader("log.npz", read, _recording(".npz")),
    "CSV, gzipped": Reader("log.csv.gz", read, _gzipped),
    "bag, sqlite3": Reader("log.db3", read, _bag(".db3")),
    "bag, MCAP": Reader("log.mcap", read, _bag(".mcap")),
    "bag, ROS 1": Reader("log.bag", read, _bag(".bag")),
    "HDF5": Reader("log.h5", read, _hdf5),
    "MATLAB": Reader("log.mat", read, _mat),
    "LeRobot": Reader("info.json", _dataset, lambda _: [INFO]),
    "map": Reader("map.yaml", _mapped, lambda _: [MAP]),
    "labels": Reader("labels.txt", _labels, lambda _: [LABELS]),
    "model": Reader("model.json", DynamicModel.load, _saved),
    "model, hash made to fit": Reader("model.json", _resealed, _saved),
    "manifest": Reader("manifest.json", lambda p: read_manifest(p.parent), _exported),
    "truth": Reader("truth.yaml", load_truth, lambda _: [TRUTH]),
    "poses": Reader(
        "poses.csv", lambda p: read_measurements(p, ROBOT.joints), lambda _: [POSES]
    ),
    "effects": Reader(
        "effects.txt", _effects, lambda _: [b"payload(mass=3),coulomb:1,viscous:elbow"]
    ),
}
