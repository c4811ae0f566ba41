"""Families of motions that begin and end at rest: Fourier series and B-splines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag, null_space

from hybrid.errors import ExcitationError
from hybrid.excitation.path import Family, Trajectory
from hybrid.robot.chain import Array

_DEGREE = 5  # of the splines: jerk is continuous


@dataclass(frozen=True)
class _Series:
    """Harmonics of one fundamental over whole periods.

    Attributes:
        order: Number of harmonics.
        fundamental: Repetitions per second, [Hz].
        periods: Whole periods the motion lasts.
    """

    name: ClassVar[str]
    least: ClassVar[int] = 1  # harmonics

    order: int = 5
    fundamental: float = 0.1
    periods: int = 1

    def __post_init__(self) -> None:
        check_series(self.order, self.fundamental, self.periods, least=self.least)

    @property
    def duration(self) -> float:
        """See :class:`~hybrid.excitation.path.Family`."""
        return self.periods / self.fundamental

    def as_dict(self) -> dict[str, Any]:
        """See :class:`~hybrid.excitation.path.Family`."""
        return {
            "name": self.name,
            "order": self.order,
            "fundamental": self.fundamental,
            "periods": self.periods,
        }


@dataclass(frozen=True)
class Fourier(_Series):
    """Harmonics of one fundamental, combined so that the motion starts at rest.

    q(t) = c₀ + Σₖ sₖ sin(kωt) + cₖ cos(kωt) with Σ k sₖ = 0 and Σ k² cₖ = 0, so that
    speed and acceleration vanish at t = 0 and after every period (Swevers et al. 1997,
    doi 10.1109/70.631234, with the condition of rest built into the basis).

    It needs two harmonics.
    """

    name: ClassVar[str] = "fourier"
    least: ClassVar[int] = 2

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


@dataclass(frozen=True)
class PlainFourier(Fourier):
    """The series of Swevers et al. 1997 as it is: it does not begin at rest.

    For comparison with designs of the literature; doi 10.1109/70.631234.
    """

    name: ClassVar[str] = "plain_fourier"

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return 2 * self.order + 1

    @cached_property
    def at_rest(self) -> Array:
        """The identity: each basis function is one term."""
        return np.eye(self.size)


@dataclass(frozen=True)
class FourierQuintic(_Series):
    """A Fourier series and a polynomial of fifth order that brings it to rest.

    In place of the constant term, p(t) = b₀ + … + b₅ t⁵ over each period T cancels the
    speed and the acceleration of the series at 0 and T and moves by nothing, so that
    the position is periodic; b₀ and the 2·order amplitudes are free.
    """

    name: ClassVar[str] = "fourier_quintic"

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return 2 * self.order + 1

    @cached_property
    def polynomials(self) -> Array:
        """Coefficients b₀ … b₅ of each basis function in t/T, shape (6, m)."""
        # Rows: p(0), p(1) − p(0), p'(0), p'(1), p''(0), p''(1) of the powers.
        powers = np.arange(6.0)
        slope, bend = powers, powers * (powers - 1)
        rows = np.stack(
            [
                powers == 0,
                powers > 0,
                slope * (powers == 1),
                slope,
                bend * (powers == 2),
                bend,
            ]
        ).astype(float)
        end = np.zeros(1)
        wanted = np.zeros((6, self.size))
        wanted[0, 0] = 1.0
        for first, derivative in ((2, 1), (4, 2)):
            series = harmonics(end, self.order, self.fundamental, derivative)
            scaled = series / self.fundamental**derivative
            wanted[first : first + 2, 1:] = -scaled
        return np.asarray(np.linalg.solve(rows, wanted))

    def basis(self, t: Array, derivative: int) -> Array:
        """See :class:`~hybrid.excitation.path.Family`."""
        phase = (t * self.fundamental) % 1.0
        # The end belongs to the last period; it is the same point by continuity.
        powers = np.arange(6)
        factor = np.ones(6)
        for k in range(derivative):
            factor = factor * np.maximum(powers - k, 0)
        left = np.maximum(powers - derivative, 0)
        monomials = factor * phase[:, None] ** left * self.fundamental**derivative
        out = monomials @ self.polynomials
        out[:, 1:] += harmonics(t, self.order, self.fundamental, derivative)
        return np.asarray(out)


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


_FAMILIES: dict[str, type[Any]] = {
    "fourier": Fourier,
    "fourier_quintic": FourierQuintic,
    "plain_fourier": PlainFourier,
    "spline": Spline,
}


def family_from_dict(content: dict[str, Any]) -> Family:
    """The family that :meth:`Family.as_dict` described.

    Raises:
        ExcitationError: There is no such family, or an option is not valid.
    """
    options = dict(content)
    name = options.pop("name", None)
    if name not in _FAMILIES:
        raise ExcitationError(
            f"no family {name!r}; valid are {', '.join(sorted(_FAMILIES))}"
        )
    try:
        family: Family = _FAMILIES[name](**options)
    except TypeError as error:
        raise ExcitationError(f"family {name!r}: {error}") from error
    return family


def trajectory_from_dict(content: dict[str, Any]) -> Trajectory:
    """The motion that :meth:`Trajectory.as_dict` described, equal to the last bit.

    Raises:
        ExcitationError: It is no such description.
    """
    try:
        family = family_from_dict(content["family"])
        return Trajectory(family, np.array(content["coefficients"], dtype=float))
    except (KeyError, TypeError, ValueError) as error:
        raise ExcitationError(f"not a saved motion: {error}") from error


def harmonics(t: Array, order: int, fundamental: float, derivative: int) -> Array:
    """A derivative of sin(kωt), then of cos(kωt), k = 1 … order; (N, 2·order)."""
    w = 2 * np.pi * fundamental * np.arange(1, order + 1)
    # Each derivative multiplies by kω and turns the phase by a quarter.
    phase = np.multiply.outer(t, w) + derivative * np.pi / 2
    return np.hstack([w**derivative * np.sin(phase), w**derivative * np.cos(phase)])


def check_series(order: int, fundamental: float, periods: int, *, least: int) -> None:
    """Refuse a series that is none.

    Raises:
        ExcitationError: An argument is out of range.
    """
    if order < least:
        raise ExcitationError(f"order is {order}, {least} or more harmonics are valid")
    if not (np.isfinite(fundamental) and fundamental > 0):
        raise ExcitationError(f"fundamental is {fundamental:g} Hz, above 0 is valid")
    if periods < 1:
        raise ExcitationError(f"periods is {periods}, 1 or more is valid")
