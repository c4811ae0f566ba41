"""Files of a simulation: recordings and their truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hybrid.files import atomic_folder, write_json
from hybrid.plant.plant import Plant
from hybrid.recording import Recording, write

TRUTH = "truth.json"


def content_from_plant(plant: Plant) -> dict[str, Any]:
    """JSON-ready truth of a simulated arm.

    The effects are those that the robot file does not have. ``inertial`` holds the
    true link parameters, shape (n, 10), and ``torque_covariance`` the noise of the
    torque sensors, shape (n, n), [N²·m²].
    """
    joints, noise = plant.robot.joints, plant.noise
    assert noise is not None  # a plant has made it
    return {
        "robot": plant.robot.name,
        "joints": list(joints),
        "effects": [effect.as_dict(joints) for effect in plant.effects],
        "inertial": plant.robot.chain.inertial.tolist(),
        "torque_covariance": noise.torque_covariance.tolist(),
    }


def recording_paths(folder: Path, trajectories: int, suffix: str) -> list[Path]:
    """Files of the recordings of a run: ``trajectory_1.csv`` and so on."""
    return [folder / f"trajectory_{k + 1}{suffix}" for k in range(trajectories)]


def write_run(
    folder: Path,
    recordings: Sequence[Recording],
    truth: Mapping[str, Any],
    *,
    suffix: str = ".csv",
) -> list[Path]:
    """Write the recordings of a run and its truth, in place of files of the same names.

    Returns:
        The files of the recordings.

    Raises:
        RecordingError: A recording cannot be written.
    """
    paths = recording_paths(folder, len(recordings), suffix)
    with atomic_folder(folder) as hidden:
        for recording, path in zip(recordings, paths, strict=True):
            write(recording, hidden / path.name)
        write_json(hidden / TRUTH, truth)
    return paths
