"""Families of motions that begin and end at rest: Fourier series and B-splines."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag, null_space

from hybrid.arrays import Array
from hybrid.errors import ExcitationError

_DEGREE = 5  # of the splines: jerk is continuous


@dataclass(frozen=True)
class Fourier:
    """Fourier series that begin and end at rest.

    q(t) = c₀ + Σₖ sₖ sin(kωt) + cₖ cos(kωt) with Σ k sₖ = 0 and Σ k² cₖ = 0, so that
    speed and acceleration are zero at t = 0 and after every period (Swevers et al.
    1997, doi 10.1109/70.631234; there the ends are not at rest).

    Attributes:
        order: Number of harmonics, two or more.
        fundamental: Repetitions per second, [Hz].
        periods: Whole periods the motion lasts.
    """

    name: ClassVar[str] = "fourier"
    least: ClassVar[int] = 2  # harmonics

    order: int = 5
    fundamental: float = 0.1
    periods: int = 1

    def __post_init__(self) -> None:
        if self.order < self.least:
            fault = f"order is {self.order}, {self.least} or more harmonics are valid"
        elif not (np.isfinite(self.fundamental) and self.fundamental > 0):
            fault = f"fundamental is {self.fundamental:g} Hz, above 0 is valid"
        elif self.periods < 1:
            fault = f"periods is {self.periods}, 1 or more is valid"
        else:
            return
        raise ExcitationError(fault)

    @property
    def duration(self) -> float:
        """See :class:`~hybrid.excitation.path.Family`."""
        return self.periods / self.fundamental

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return 2 * self.order - 1

    @cached_property
    def at_rest(self) -> Array:
        """Series (c₀, s, c) of each basis function, shape (2·order + 1, m)."""
        k = np.arange(1, self.order + 1) / self.order
        sine, cosine = null_space(k[None]), null_space(k[None] ** 2)
        return np.asarray(block_diag(np.eye(1), sine, cosine))

    def basis(self, t: Array, derivative: int) -> Array:
        """See :class:`~hybrid.excitation.path.Family`."""
        series = harmonics(t, self.order, self.fundamental, derivative)
        constant = np.full((len(t), 1), 1.0 if derivative == 0 else 0.0)
        return np.asarray(np.hstack([constant, series]) @ self.at_rest)

    def as_dict(self) -> dict[str, Any]:
        """See :class:`~hybrid.excitation.path.Family`."""
        return {"name": self.name, **asdict(self)}


@dataclass(frozen=True)
class Spline:
    """Quintic B-splines on uniform knots, clamped, at rest at both ends.

    The first three control points are equal, and so are the last three, so that speed
    and acceleration are zero there. The motion may end at another position.

    Attributes:
        duration: Length of the motion, [s].
        size: Number of free control points m, at least 3.
    """

    duration: float = 10.0
    size: int = 12

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ExcitationError(f"length is {self.duration:g} s, above 0 is valid")
        if self.size < 3:
            raise ExcitationError(f"points is {self.size}, 3 or more are valid")

    @cached_property
    def _spline(self) -> BSpline:
        control = np.pad(np.eye(self.size), ((2, 2), (0, 0)), mode="edge")
        inner = np.linspace(0.0, self.duration, len(control) - _DEGREE + 1)
        return BSpline(np.pad(inner, _DEGREE, mode="edge"), control, _DEGREE)

    def basis(self, t: Array, derivative: int) -> Array:
        """See :class:`~hybrid.excitation.path.Family`."""
        return np.asarray(self._spline(np.minimum(t, self.duration), nu=derivative))

    def as_dict(self) -> dict[str, Any]:
        """See :class:`~hybrid.excitation.path.Family`."""
        return {"name": "spline", "length": self.duration, "points": self.size}


def harmonics(t: Array, order: int, fundamental: float, derivative: int) -> Array:
    """A derivative of sin(kωt), then of cos(kωt), k = 1 … order; (N, 2·order)."""
    w = 2 * np.pi * fundamental * np.arange(1, order + 1)
    # Each derivative multiplies by kω and shifts the phase by π/2.
    phase = np.multiply.outer(t, w) + derivative * np.pi / 2
    return np.hstack([w**derivative * np.sin(phase), w**derivative * np.cos(phase)])
