"""Figures of a designed motion: its course, its information, the arm along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.kinematics import frames
from hybrid.errors import RobotError
from hybrid.excitation import Design, Limits
from hybrid.excitation.clearance import ends_in_world
from hybrid.names import figure_text
from hybrid.plant.reference import Reference
from hybrid.report.style import (
    BLUE,
    GREY,
    OTHERS,
    RED,
    Figure,
    clean,
    legend,
    lines_figure,
    new_figure,
)
from hybrid.robot.geometry import capsules_from_robot
from hybrid.robot.robot import Robot

_COLUMNS = 4
_THICKEST = 24.0  # points


@dataclass(frozen=True, eq=False)
class Postures:
    """K postures of an arm of n joints in the base frame.

    Attributes:
        joints: Origins of the base and the joints, shape (K, n + 1, 3), [m].
        ends: End points of C capsules, shape (K, C, 2, 3), [m]; C is 0 if the robot
            file has no geometry.
        radius: Radii of the capsules, shape (C,), [m].
    """

    joints: Array
    ends: Array
    radius: Array

    @classmethod
    def of(cls, robot: Robot, q: Array) -> Postures:
        """The postures of an arm at positions q, shape (K, n), [rad or m]."""
        origins = frames(robot.chain, q)[1].transpose(1, 0, 2)
        joints = np.concatenate([np.zeros((len(q), 1, 3)), origins], axis=1)
        try:
            capsules = capsules_from_robot(robot)
        except RobotError:
            return cls(joints, np.zeros((len(q), 0, 2, 3)), np.zeros(0))
        return cls(joints, ends_in_world(robot.chain, capsules, q), capsules.radius)

    @property
    def box(self) -> tuple[Array, float]:
        """Centre and half width of a cube around all postures, [m]."""
        points = np.concatenate([self.joints.reshape(-1, 3), self.ends.reshape(-1, 3)])
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, max(0.55 * float((high - low).max()), 1e-3)


def motion_figure(
    reference: Reference, joints: Sequence[str], limits: Limits
) -> Figure:
    """Draw position and speed of every joint, with its limits."""
    rows = {
        "position\n[rad]": [("", reference.q, BLUE, 1.2)],
        "speed\n[rad/s]": [("", reference.v, OTHERS[0], 1.0)],
    }
    figure, cells = lines_figure(reference.t, joints, rows, 2.1, ratios=(1.4, 1.0))
    bounds = (limits.low, limits.high), (-limits.speed, limits.speed)
    for j, cell in enumerate(cells):
        for axes, pair in zip(cell, bounds, strict=True):
            for level in pair:
                axes.axhline(level[j], color=RED, linewidth=0.8, linestyle=":")
    return figure


def information_figure(design: Design) -> Figure:
    """Draw singular values of the observation matrix, and predicted standard errors."""
    figure = new_figure(height=5.2)
    above, below = figure.subplots(2, 1, height_ratios=(1.0, 1.3))
    order = np.arange(1, design.observation.size + 1)
    sums = np.cumsum(design.grams, axis=0)
    handles = []
    for k, gram in enumerate(sums):
        values = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0))
        last = k == len(sums) - 1
        line = above.plot(
            order, values, ".-", color=BLUE if last else GREY, markersize=4,
            linewidth=0.9, alpha=1.0 if last else 0.3 + 0.5 * k / len(sums),
            label=f"{k + 1} motion{'s' if k else ''}",
        )  # fmt: skip
        handles += line
    above.set_yscale("log")
    above.set_ylabel("singular value")
    above.set_xlabel(f"of {design.observation.size}, largest first")
    labels = [_short(x) for x in design.observation.base.kept_labels]
    errors = design.standard_errors() / design.observation.scale
    below.plot(order, errors, "o", color=BLUE, markersize=4)
    below.set_yscale("log")
    below.set_ylabel("predicted standard error\n[SI units]")
    small = 8 if len(labels) < 30 else 5
    below.set_xticks(order, [*map(figure_text, labels)], rotation=90)
    for axes in (above, below):
        clean(axes, grid="y")
        axes.tick_params(which="both", labelsize=8)
    below.tick_params(axis="x", labelsize=small)
    legend(figure, handles[:8])
    return figure


def _short(label: str) -> str:
    """``viscous, elbow`` from ``viscous.coefficient[elbow]``; others are unchanged."""
    effect, _, rest = label.partition(".")
    joint = rest.partition("[")[2].rstrip("]")
    return f"{effect}, {joint}" if joint else label


def postures_figure(robot: Robot, reference: Reference, *, count: int = 8) -> Figure:
    """Draw the arm at equidistant times of a motion."""
    samples = np.linspace(0, len(reference.t) - 1, count).round().astype(int)
    postures = Postures.of(robot, reference.q[samples])
    rows = -(-count // _COLUMNS)
    figure = new_figure(0.1 + 1.9 * rows)
    for k, sample in enumerate(samples):
        axes: Any = figure.add_subplot(rows, _COLUMNS, k + 1, projection="3d")
        _draw(axes, postures, k)
        axes.set_title(f"{reference.t[sample]:.1f} s", fontsize=8, y=0.95)
    return figure


def _draw(axes: Any, postures: Postures, k: int) -> None:
    """Draw posture ``k`` on 3-D axes with the box of all postures."""
    center, size = postures.box
    inch = min(axes.get_position().size * axes.figure.get_size_inches())
    points_per_metre = 72 * inch / (2 * size)
    for body, radius in zip(postures.ends[k], postures.radius, strict=True):
        width = min(2 * radius * points_per_metre, _THICKEST)
        axes.plot(
            *body.T, color=GREY, alpha=0.35, linewidth=width, solid_capstyle="round"
        )
    axes.plot(*postures.joints[k].T, "o-", color=BLUE, linewidth=1.5, markersize=2.5)
    axes.plot(*postures.joints[k, -1:].T, "o", color=RED, markersize=3.5)
    for axis, middle in zip("xyz", center, strict=True):
        getattr(axes, f"set_{axis}lim")(middle - size, middle + size)
        getattr(axes, f"{axis}axis").set_ticklabels([])
        getattr(axes, f"{axis}axis").set_tick_params(length=0)
    axes.set_box_aspect((1, 1, 1))
