"""B-splines that begin and end at rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from hybrid.errors import ExcitationError
from hybrid.robot.chain import Array

_DEGREE = 5  # jerk is continuous


@dataclass(frozen=True)
class Spline:
    """Quintic B-splines on uniform knots, clamped, at rest at both ends.

    The first three control points are equal, and so are the last three: speed and
    acceleration vanish there. The motion need not end where it began.

    Attributes:
        length: Duration of the motion, [s].
        points: Number of free control points m, at least 3.
    """

    length: float = 10.0
    points: int = 12

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length) and self.length > 0):
            raise ExcitationError(f"length is {self.length:g} s, above 0 is valid")
        if self.points < 3:
            raise ExcitationError(f"points is {self.points}, 3 or more are valid")

    @property
    def duration(self) -> float:
        """See :class:`~hybrid.excitation.path.Family`."""
        return self.length

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return self.points

    @cached_property
    def _spline(self) -> BSpline:
        control = np.eye(self.points)
        control = np.vstack([control[:1], control[:1], control, *[control[-1:]] * 2])
        inner = np.linspace(0.0, self.length, len(control) - _DEGREE + 1)
        knots = np.concatenate(
            [np.zeros(_DEGREE), inner, np.full(_DEGREE, self.length)]
        )
        return BSpline(knots, control, _DEGREE)

    def basis(self, t: Array, derivative: int) -> Array:
        """See :class:`~hybrid.excitation.path.Family`."""
        return np.asarray(self._spline(np.minimum(t, self.length), nu=derivative))

    def as_dict(self) -> dict[str, Any]:
        """See :class:`~hybrid.excitation.path.Family`."""
        return {"name": "spline", "length": self.length, "points": self.points}
