"""Predicted measurements of an arm, and their derivatives by its parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array, Index
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.steps import FixedStep, Frame, Step, Values, follow, start

Steps = tuple[FixedStep | Step, ...]


@dataclass(frozen=True)
class Block:
    """Residuals of one kind: U units (points, orientations) of c components each."""

    name: str  # position, orientation or distance
    residual: Array  # model − measurement, shape (U, c), [m or rad]
    jacobian: Array  # derivative of the residual, shape (U, c, p)
    pose: Index  # of each unit, shape (U,)


@dataclass(frozen=True)
class KinematicModel:
    """Kinematics from the instrument along the arm to each measured point."""

    steps: Steps  # from the instrument's frame to the flange
    tools: tuple[Steps, ...]  # from the flange to each of the r measured points
    stations: tuple[Steps, ...] = ()  # from the base to each of a distance meter

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each parameter by its name, in their order along the kinematics."""
        found = {
            step.parameter: step.unit
            for steps in (self.steps, *self.tools, *self.stations)
            for step in steps
            if isinstance(step, Step) and step.parameter
        }
        return found | ({"scale": ""} if self.stations else {})

    def frames(
        self, q: Array, values: Values, load: Array | None = None
    ) -> list[Frame]:
        """Frame at the end of each tool, see :func:`follow`."""
        flange = follow(start(q), self.steps, q, values, load)
        return [follow(flange, tool, q, values, load) for tool in self.tools]

    def blocks(
        self,
        data: Measurements,
        labels: Sequence[str],
        x: Array,
        load: Array | None = None,
    ) -> list[Block]:
        """Residuals and their derivatives, without missing measurements.

        The free parameters have labels, length p, and values, shape (p,); each joint
        has a load, shape (N, n), [N·m].
        """
        values = dict(zip(labels, x.tolist(), strict=True))
        frames = self.frames(data.q, values, load)
        if data.distance is not None:
            stations = [follow(start(data.q), x, data.q, values) for x in self.stations]
            stretch = values.get("scale", 0.0)
            return [_distances(data.distance, frames[0], stations, stretch, labels)]
        linear = [_velocities(frame, labels)[0] for frame in frames]
        residual = np.stack([frame.origin for frame in frames], axis=1) - data.position
        blocks = [_block("position", residual, np.stack(linear, axis=1))]
        if data.rotation is not None:
            angular = _velocities(frames[0], labels)[1]
            blocks.append(_orientations(data.rotation, frames[0].rotation, angular))
        return blocks


def _distances(
    measured: Array,
    tool: Frame,
    stations: Sequence[Frame],
    scale: float,
    labels: Sequence[str],
) -> Block:
    """Block of the distances of a tool from stations, shape (N, s)."""
    linear = _velocities(tool, labels)[0]  # (N, 3, p)
    residual = np.empty((*measured.shape, 1))
    jacobian = np.empty((*measured.shape, 1, len(labels)))
    for j, station in enumerate(stations):
        between = tool.origin - station.origin
        length = np.linalg.norm(between, axis=1)
        way = (1.0 + scale) * between / length[:, None]
        moves = linear - _velocities(station, labels)[0]
        residual[:, j, 0] = (1.0 + scale) * length - measured[:, j]
        jacobian[:, j, 0] = np.einsum("nc,ncp->np", way, moves)
        if "scale" in labels:
            jacobian[:, j, 0, labels.index("scale")] = length
    return _block("distance", residual, jacobian)


def _velocities(frame: Frame, labels: Sequence[str]) -> tuple[Array, Array]:
    """Linear and angular velocity of a frame per parameter, shape (N, 3, p) each."""
    linear = np.zeros((*frame.origin.shape, len(labels)))
    angular = np.zeros_like(linear)
    here = [k for k, label in enumerate(labels) if label in frame.twists]
    if here:
        twists = np.stack([frame.twists[labels[k]] for k in here], axis=-1)
        moves, turns = np.split(twists, 2, axis=-2)  # (N, 3, p)
        linear[..., here] = moves + np.cross(turns, frame.origin[..., None], axis=-2)
        angular[..., here] = turns
    return linear, angular


def _block(name: str, residual: Array, jacobian: Array) -> Block:
    """Block of the finite residuals (N, r, c) and derivatives (N, r, c, p)."""
    seen = np.isfinite(residual).all(axis=-1)
    return Block(name, residual[seen], jacobian[seen], np.nonzero(seen)[0])


def _orientations(measured: Array, model: Array, angular: Array) -> Block:
    """Block of rotation vectors from the measured to the modelled orientation."""
    seen = np.isfinite(measured).all(axis=(1, 2))
    turn = model[seen] @ measured[seen].swapaxes(1, 2)
    vector = Rotation.from_matrix(turn).as_rotvec()
    jacobian = _log_derivative(vector) @ angular[seen]
    return Block("orientation", vector, jacobian, np.nonzero(seen)[0])


def _log_derivative(vector: Array) -> Array:
    """Change of a rotation vector per angular velocity, shape (N, 3, 3).

    Inverse left Jacobian of SO(3): Barfoot 2017, doi 10.1017/9781316671528, eq. 7.77.
    """
    angle = np.linalg.norm(vector, axis=1)
    far = np.maximum(angle, 1e-3)  # below, the factor is 1/12 to 7 digits
    factor = 1 / far**2 - (1 + np.cos(far)) / (2 * far * np.sin(far))
    skew = np.cross(np.eye(3), vector[:, None, :])  # row k: eₖ × v
    derivative: Array = np.eye(3) - 0.5 * skew + factor[:, None, None] * (skew @ skew)
    return derivative
