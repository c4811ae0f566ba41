"""The verb ``simulate``: recordings of random motions of a simulated arm, and files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.effects import Effect
from hybrid.errors import HybridError
from hybrid.files import atomic_folder, write_json
from hybrid.plant.noise import Noise
from hybrid.plant.plant import Plant
from hybrid.plant.reference import random_fourier
from hybrid.recording import Recording, write
from hybrid.robot.robot import Robot

TRUTH = "truth.json"


@typed
def simulate(
    robot: Robot | Plant,
    effects: Sequence[Effect] = (),
    *,
    trajectories: int = 4,
    duration: float = 10.0,
    seed: int = 0,
    noise: Noise | None = None,
    fill: float = 0.7,
    log_rate: float | None = None,
) -> list[Recording]:
    """Simulate random motions of an arm with effects that its file does not have.

    Args:
        robot: The arm; or a plant, which has its own effects, noise and rates.
        effects: Effects to add.
        trajectories: Number of motions.
        duration: Length of each, [s].
        seed: Seed of motions and noise; the same seed gives the same arrays.
        noise: Sensor noise; by default that of :meth:`Noise.typical`.
        fill: Share of the arm's position, speed and acceleration limits to use.
        log_rate: Samples per second of the recordings, [Hz]; 500 by default.

    Returns:
        One recording for each trajectory.

    Raises:
        HybridError: An argument is out of range, or an effect cannot be simulated.
    """
    if trajectories < 1:
        raise HybridError(f"trajectories is {trajectories}, 1 or more is valid")
    if isinstance(robot, Plant):
        if effects or noise is not None or log_rate is not None:
            raise HybridError(
                "a plant has its own effects, noise and rates; pass a robot instead"
            )
        plant = robot
    else:
        rate = 500.0 if log_rate is None else log_rate
        plant = Plant(robot, effects, noise=noise, log_rate=rate)
    motion_rng, noise_rng = np.random.default_rng(seed).spawn(2)
    references = [
        random_fourier(
            plant.nominal or plant.robot,
            duration=duration,
            rate=plant.log_rate,
            seed=child,
            fill=fill,
        )
        for child in motion_rng.spawn(trajectories)
    ]
    return plant.run(references, seed=noise_rng)


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
