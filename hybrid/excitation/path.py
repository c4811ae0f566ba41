"""A motion with its derivatives on a grid of times, and families of such motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BPoly

from hybrid.arrays import Array
from hybrid.errors import ExcitationError
from hybrid.plant.reference import Reference

DERIVATIVES = 4  # position, speed, acceleration, jerk


@dataclass(frozen=True, eq=False)
class Path:
    """Samples of a motion: times (N,), [s], and the rest (N, n), in rad and s."""

    t: Array
    q: Array
    v: Array
    a: Array
    jerk: Array

    def at(self, samples: Any) -> Path:
        """Some of the samples."""
        return Path(*(x[samples] for x in vars(self).values()))

    @classmethod
    def joined(cls, paths: Sequence[Path]) -> Path:
        """Paths one after the other, as rows of one table; time is not continued."""
        each = zip(*(vars(path).values() for path in paths), strict=True)
        return cls(*map(np.concatenate, each))


class Family(Protocol):
    """Motions of one joint that are linear in m coefficients.

    They begin and end with zero speed and zero acceleration.
    """

    @property
    def duration(self) -> float:
        """Length of the motion, [s]."""

    @property
    def size(self) -> int:
        """Number of coefficients m of a joint."""

    def basis(self, t: Array, derivative: int) -> Array:
        """Derivative of every basis function, shape (N, m), [1/s^derivative]."""

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready description: name and options."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion of n joints: a family and its coefficients, shape (m, n), [rad]."""

    family: Family
    coefficients: Array

    def __post_init__(self) -> None:
        x = np.asarray(self.coefficients, dtype=float)
        if x.ndim != 2 or len(x) != self.family.size or not np.isfinite(x).all():
            raise ExcitationError(
                f"coefficients need shape ({self.family.size}, joints) and finite "
                f"values; these have shape {x.shape}"
            )
        object.__setattr__(self, "coefficients", x)

    def path(self, t: Array) -> Path:
        """Samples at the times ``t``, shape (N,), [s]."""
        return Grid(self.family, t).path(self.coefficients)

    def reference(self, rate: float) -> Reference:
        """The motion as a reference, at a number of samples per second [Hz]."""
        if not (np.isfinite(rate) and rate * self.family.duration >= 2):
            raise ExcitationError(f"rate is {rate:g} Hz, two samples or more are valid")
        path = self.path(uniform(self.family.duration, rate))
        return Reference(path.t, path.q, path.v, path.a)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        content = {"family": self.family.as_dict()}
        return content | {"coefficients": self.coefficients.tolist()}


@dataclass(frozen=True, eq=False)
class Grid:
    """Basis functions of a family at fixed times (N,), [s]."""

    family: Family
    t: Array

    @cached_property
    def bases(self) -> Array:
        """Basis of position, speed, acceleration and jerk, shape (4, N, m)."""
        return np.stack([self.family.basis(self.t, k) for k in range(DERIVATIVES)])

    def path(self, coefficients: Array) -> Path:
        """Samples of the motion with these coefficients, shape (m, n)."""
        return Path(self.t, *(self.bases @ coefficients))

    def gradient(self, *by: Array) -> Array:
        """Derivatives by the coefficients, shape (m, n), from those by the samples.

        These are by q, v, a and jerk, or the first of them, shape (N, n) each.
        """
        pairs = zip(self.bases, by, strict=False)
        return np.asarray(sum(basis.T @ x for basis, x in pairs))


def quintic(t: Array, q: Array, v: Array, a: Array) -> BPoly:
    """Polynomials of degree five through states at K rising times [s], Bernstein form.

    Positions, speeds and accelerations have the shape (K, ...).
    """
    h = np.diff(t).reshape(-1, *[1] * (q.ndim - 1))
    first, last = h * v[:-1] / 5, h * v[1:] / 5
    begin, end = h**2 * a[:-1] / 20, h**2 * a[1:] / 20
    return BPoly(
        np.stack([
            q[:-1], q[:-1] + first, q[:-1] + 2 * first + begin,
            q[1:] - 2 * last + end, q[1:] - last, q[1:],
        ]),
        t,
    )  # fmt: skip


def uniform(duration: float, rate: float) -> Array:
    """Times from 0 to the end at about ``rate`` samples per second, [s]."""
    return np.linspace(0.0, duration, round(duration * rate) + 1)
