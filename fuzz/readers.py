"""Every reader and loader of the package, with files that it takes: what is fuzzed."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid.calibrate.read import read_measurements
from hybrid.dynamics import stacked_base
from hybrid.effects import effects_from_text
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError
from hybrid.export import export, read_manifest
from hybrid.files import write_json
from hybrid.identify import DynamicModel
from hybrid.model.model_file import content_digest
from hybrid.plant import load_truth
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording, read, write
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
