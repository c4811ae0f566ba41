"""Cross-validation of a calibration on held-out poses."""

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration.calibrate import USUAL, build_setup, calibrate
from hybrid.calibration.measurements import Measurements
from hybrid.errors import CalibrationError
from hybrid.robot import Robot


@dataclass(frozen=True)
class Errors:
    """Distances of model and measurement on held-out poses, (units,), [m or rad].

    They are those of the nominal arm with fitted frames and of the calibrated arm, by
    kind of measurement.
    """

    nominal: dict[str, Array]
    calibrated: dict[str, Array]


def cross_validate(
    robot: Robot,
    data: Measurements,
    *,
    free: Collection[str] = USUAL,
    robust: bool = True,
    folds: int = 5,
) -> Errors:
    """Leave out every ``folds``-th pose in turn, and predict it from the others.

    See :func:`~hybrid.calibration.calibrate`; errors include those of outliers.

    Raises:
        CalibrationError: There are too few poses.
    """
    if not 2 <= folds <= data.size:
        raise CalibrationError(
            f"{folds} parts; valid are 2 to {data.size}, the number of poses"
        )
    part = np.arange(data.size) % folds
    found = []
    for groups in (_frames(free), free):
        parts: dict[str, list[Array]] = defaultdict(list)
        for k in range(folds):
            fit, test = data.at(part != k), data.at(part == k)
            for kind, sizes in _errors(robot, fit, test, groups, robust).items():
                parts[kind].append(sizes)
        found.append({kind: np.concatenate(x) for kind, x in parts.items()})
    return Errors(*found)


def nominal_errors(
    robot: Robot, data: Measurements, *, free: Collection[str], robust: bool
) -> dict[str, Array]:
    """Errors of the nominal arm with frames fitted to the same poses, by kind."""
    return _errors(robot, data, data, _frames(free), robust)


def _frames(free: Collection[str]) -> Collection[str]:
    return [group for group in free if group in ("base", "tool")]


def _errors(
    robot: Robot,
    fit: Measurements,
    test: Measurements,
    free: Collection[str],
    robust: bool,
) -> dict[str, Array]:
    setup = build_setup(robot, fit, free=free)
    if setup.labels:
        return calibrate(robot, fit, free=free, robust=robust).errors(test)
    # Base and tool are known, so there is nothing to fit to the nominal arm.
    return setup.errors(test, (), np.zeros(0))
