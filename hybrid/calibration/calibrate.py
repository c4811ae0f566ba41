"""Calibration of the geometry of an arm from measured poses."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.calibration.alignment import align
from hybrid.calibration.geometry import Geometry, chain_from_values, geometry_from_chain
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.model import KinematicModel, Steps
from hybrid.calibration.solve import KinematicSolution, solve
from hybrid.calibration.steps import FixedStep, follow, free_frame, start
from hybrid.dynamics import inverse_dynamics
from hybrid.errors import CalibrationError, RobotError, warn
from hybrid.parameters import Parameter
from hybrid.robot import Robot
from hybrid.robot.edit.placements import write_placements
from hybrid.shown import Shown

GROUPS = ("base", "tool", "geometry", "compliance", "scale")
USUAL = ("base", "tool", "geometry")
# Group of each kind of parameter. Of equivalent parameters the first is identified:
# frames of the instrument before those of the arm, joint angles before lengths before
# tilts.
_GROUP = {
    "base": "base", "tool": "tool", "reflector": "tool", "station": "base",
    "theta": "geometry", "a": "geometry", "alpha": "geometry", "d": "geometry",
    "beta": "geometry", "compliance": "compliance", "scale": "scale",
}  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """The problem that :func:`calibrate` solves.

    The nominal arm has a geometry of Denavit-Hartenberg rows, and an aligned model from
    the instrument to the measured points. Of equivalent ones among the free parameters,
    the first is identified. The load is the torque of gravity, shape (N, n), [N·m].
    """

    robot: Robot
    geometry: Geometry
    model: KinematicModel
    labels: tuple[str, ...]
    load: Array

    def errors(
        self, data: Measurements, labels: tuple[str, ...], x: Array
    ) -> dict[str, Array]:
        """Distance of model and measurement of each unit, by kind, [m or rad]."""
        blocks = self.model.blocks(data, labels, x, _load(self.robot, data.q))
        return {b.name: np.linalg.norm(b.residual, axis=1) for b in blocks}


@dataclass(frozen=True, repr=False)
class Calibration(Shown):
    """A calibrated arm: the problem, the estimates and the measurements."""

    setup: Setup
    solution: KinematicSolution
    data: Measurements

    @cached_property
    def robot(self) -> Robot:
        """The arm with calibrated geometry."""
        nominal, values = self.setup.robot, self.solution.values()
        chain = chain_from_values(nominal.chain, self.setup.geometry, values)
        return replace(nominal, chain=chain)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Corrections to the nominal arm, with standard deviations."""
        units, std = self.setup.model.units, self.solution.std.tolist()
        return tuple(
            Parameter(label, x, unit=units[label], std=own)
            for (label, x), own in zip(self.solution.values().items(), std, strict=True)
        )

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Corrections that these measurements do not identify, in words."""
        chain = self.setup.robot.chain
        lines = [
            f"{label}: joins {joined}" if joined else f"{label}: moves nothing measured"
            for label, joined in self.solution.reduced.dropped.items()
        ]
        if any(label.startswith("theta_") for label in self.setup.labels):
            for k in np.flatnonzero(self.setup.geometry.parallel):
                joined = f"d_{chain.joints[k]}: joins d_{chain.joints[k + 1]}"
                lines.append(f"{joined}, the axes are parallel")
        return tuple(lines)

    @property
    def observability(self) -> float:
        """Observability index O₁ of the poses, in units of the noise."""
        return observability_index(self.solution.jacobian, self.data.size)

    @property
    def base(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and origin (3,) [m] of the base in the instrument's frame."""
        steps = self.setup.model.steps
        return self._frame(steps[: len(steps) - len(self.setup.geometry.steps)])

    @property
    def tools(self) -> list[tuple[Array, Array]]:
        """Rotation (3, 3) and origin (3,) [m] of each point on the last link."""
        return [self._frame(steps) for steps in self.setup.model.tools]

    @property
    def stations(self) -> Array:
        """Stations of a distance meter in the base frame, shape (s, 3), [m]."""
        found = [self._frame(steps)[1] for steps in self.setup.model.stations]
        return np.array(found).reshape(-1, 3)

    def save(self, path: str | Path) -> None:
        """Write the robot's file with calibrated joint placements.

        Raises:
            RobotError: The robot's file is missing, or cannot hold a placement.

        Warns:
            HybridWarning: The new file cannot be read from where it is.
        """
        write_placements(self.setup.robot, self.robot.chain, path)
        try:
            Robot.load(path, joints=self.robot.joints, held=self.robot.held)
        except RobotError:
            warn(
                f"{path} refers to files beside {Path(self.setup.robot.path).name}; "
                "move it there"
            )

    def _frame(self, steps: Steps) -> tuple[Array, Array]:
        q = np.zeros((1, self.setup.robot.size))
        end = follow(start(q), steps, q, self.solution.values())
        return end.rotation[0], end.origin[0]

    def errors(self, data: Measurements) -> dict[str, Array]:
        """Distance of model and measurement of each unit, by kind, [m or rad]."""
        return self.setup.errors(data, self.solution.labels, self.solution.x)


@typed
def calibrate(
    robot: Robot,
    data: Measurements,
    *,
    free: Collection[str] = USUAL,
    robust: bool = True,
) -> Calibration:
    """Calibrate an arm.

    Args:
        robot: Nominal arm.
        data: Measurements in static poses.
        free: Unknowns: ``base`` and ``tool`` frames, ``geometry`` of the arm,
            ``compliance`` of its joints under gravity, ``scale`` of a distance meter.
        robust: Whether outliers are left out.

    Raises:
        CalibrationError: The data are not of this arm, or too few.

    Warns:
        HybridWarning: The estimates have not converged.
    """
    setup = build_setup(robot, data, free=free)
    if not setup.labels:
        raise CalibrationError(f"nothing is free; valid are {', '.join(GROUPS)}")
    solution = solve(
        setup.model,
        data,
        setup.labels,
        frames=sum(_group(label) in ("base", "tool") for label in setup.labels),
        load=setup.load,
        robust=robust,
    )
    if not solution.converged:
        warn(
            f"{data.source}: the estimates have not settled after "
            f"{solution.iterations} iterations; measure more, or more different, poses"
        )
    return Calibration(setup, solution, data)


def build_setup(
    robot: Robot, data: Measurements, *, free: Collection[str] = USUAL
) -> Setup:
    """The problem that :func:`calibrate` solves, with initial estimates.

    Raises:
        CalibrationError: The data are not of this arm, or a group is unknown.
    """
    _check(robot, data, free)
    geometry = geometry_from_chain(robot.chain)
    flange = follow(start(data.q), geometry.steps, data.q, {})
    place, frames, places = align(
        flange, data, base="base" in free, tool="tool" in free
    )
    base: Steps = () if data.stations else (place, *free_frame("base"))
    turns = data.rotation is not None
    tools: list[Steps] = [
        (tool, *free_frame(f"reflector_{j + 1}" if frames[1:] else "tool", turns=turns))
        for j, tool in enumerate(frames)
    ]
    stations: list[Steps] = [
        (FixedStep(np.eye(3), x), *free_frame(f"station_{j + 1}", turns=False))
        for j, x in enumerate(places)
    ]
    model = KinematicModel((*base, *geometry.steps), tuple(tools), tuple(stations))
    rank = [*_GROUP].index
    labels = sorted(
        (x for x in model.units if _group(x) in free or x.startswith("station_")),
        key=lambda label: rank(label.split("_")[0]),
    )
    return Setup(robot, geometry, model, tuple(labels), _load(robot, data.q))


def observability_index(jacobian: Array, poses: int) -> float:
    """Index O₁: geometric mean of the singular values over the root of the poses.

    Borm and Menq 1991, doi 10.1177/027836499101000106. A larger index means a smaller
    volume of the confidence region. Derivatives over noise have the shape (rows, b).
    """
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    if sizes[-1] <= 0:
        return 0.0
    return float(np.exp(np.log(sizes).mean()) / np.sqrt(poses))


def _group(label: str) -> str:
    return _GROUP[label.split("_")[0]]


def _load(robot: Robot, q: Array) -> Array:
    """Torque of gravity on each joint at rest, shape (N, n), [N·m]."""
    still = np.zeros_like(q)
    return -inverse_dynamics(robot.chain, robot.chain.inertial, q, still, still)


def _check(robot: Robot, data: Measurements, free: Collection[str]) -> None:
    unknown = [group for group in free if group not in GROUPS]
    if unknown:
        raise CalibrationError(
            f"cannot free {', '.join(unknown)}; valid are {', '.join(GROUPS)}"
        )
    if data.q.shape[1] != robot.size:
        raise CalibrationError(
            f"{data.source}: positions of {data.q.shape[1]} joints; {robot.name} has "
            f"{robot.size}: {', '.join(robot.joints)}"
        )
    if data.reflectors > 1 and "tool" not in free:
        raise CalibrationError(
            "of several points on the flange the places are unknown; add tool to what "
            "is free"
        )
    if "compliance" in free and not robot.chain.inertial[:, 0].any():
        raise CalibrationError(
            f"{robot.name} has no masses, so gravity bends nothing; leave compliance "
            "out of what is free"
        )
