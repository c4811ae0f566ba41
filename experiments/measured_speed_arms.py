"""Plain least squares on motions of a log made in three ways, and its errors."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from real_arms_data import ARMS, Arm

from hybrid import DynamicModel, Motion, Robot, identify, read_recordings
from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.errors import HybridWarning
from hybrid.recording import Recording
from hybrid.report import Table
from hybrid.signals import (
    Sampler,
    butterworth,
    central_difference,
    choose_cutoff,
    motion_from_recording,
)

WAYS = ("position alone", "speed alone", "both")


def motion(log: Recording, cutoff: float, way: str) -> Motion:
    """A log's motion from its position, with its speed as it is, or from both."""
    if way == "both":
        return motion_from_recording(log, cutoff=cutoff)
    made = motion_from_recording(replace(log, v=None), cutoff=cutoff)
    if way == "position alone":
        return made
    v = butterworth(log.v, rate=made.rate, cutoff=cutoff)
    return replace(made, v=v, a=central_difference(v, rate=made.rate))


def plain(
    robot: Robot, motions: Sequence[Motion], cutoff: float, effects: Sequence[Effect]
) -> DynamicModel:
    """Weighted least squares with linear friction."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        fit = identify(robot, motions, effects=effects, cutoff=cutoff, stages=())
    return fit.model.simpler["WLS"]


def errors(arm: Arm, data: Path, way: str) -> Array | None:
    """Mean RMS of held-out torque at full rate and low-passed, (2,), [N·m].

    None where the log has no speed. Cut-offs are the automatic ones.
    """
    robot = Robot.load(data / arm.folder / "robot.urdf")
    logs = read_recordings([data / arm.folder], joints=robot.joints)
    if any(log.v is None for log in logs) and way != "position alone":
        return None
    cutoff = float(np.median([choose_cutoff(log) for log in logs]))
    found = []
    motions = [motion(log, 2 * cutoff, way) for log in logs]
    orders = [motions] if arm.block else [motions, motions[::-1]]
    for order in orders:
        for _, fitting, scoring in arm.splits(order):
            model = plain(robot, [fitting], cutoff, arm.effects)
            left = scoring.tau - model.predict(scoring)
            low = Sampler(scoring.rate, arm.cutoff, 1)(left)
            use = scoring.mask[:, None] & (np.abs(scoring.v) > arm.standing)
            squares = np.where(use, [left**2, low**2], 0.0).sum(axis=1)
            found.append(np.sqrt(squares / use.sum(axis=0)).mean(axis=1))
    return np.asarray(np.mean(found, axis=0))


def arms_table(data: Path) -> Table:
    """Errors of all arms, a row an arm, full rate and low-passed for each way."""
    rows = []
    for arm in ARMS:
        cells = [errors(arm, data, way) for way in WAYS]
        texts = ["no speed" if x is None else f"{x[0]:.4g} / {x[1]:.4g}" for x in cells]
        rows.append((arm.name, *texts))
    caption = (
        "Held-out RMS torque error of plain weighted least squares, mean of joints, "
        "N·m, at the log's rate / low-passed"
    )
    return Table(("", *WAYS), tuple(rows), caption)
