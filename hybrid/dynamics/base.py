"""Base parameters: the identifiable combinations of standard parameters.

Source: Gautier 1991, doi 10.1002/rob.4620080405 (numerical computation by QR).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from hybrid.arrays import Array
from hybrid.robot.chain import INERTIAL_NAMES, INERTIAL_UNITS

# Share of a column outside the span of others below which it is dependent. Rounded
# angles in a file, such as 1.5708 for π/2, make such columns.
_RANK_TOLERANCE = 1e-5
_ROUNDING = 1e-10  # coefficient of unit columns that counts as zero
_NEGLIGIBLE = 1e-5  # coefficient that is not part of a name


@dataclass(frozen=True)
class BaseParameters:
    """The b identifiable combinations of p standard parameters.

    A base parameter is one *kept* standard parameter plus multiples of dropped ones.

    Attributes:
        labels: Names of the standard parameters, length p.
        units: Their units, length p.
        kept: Indices of the kept standard parameters, shape (b,).
        mapping: Base parameters from standard ones, shape (b, p).
        values: Values of the base parameters, shape (b,).
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    kept: tuple[int, ...]
    mapping: Array
    values: Array

    @property
    def size(self) -> int:
        """Number of base parameters b."""
        return len(self.kept)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Each combination in full, e.g. ``"Izz_1 + Iyy_2 − 0.2·mx_2"``, length b."""
        names = list(self.kept_labels)
        for k, column in np.argwhere(np.abs(self.mapping) > _NEGLIGIBLE):
            if column != self.kept[k]:
                factor = self.mapping[k, column]
                size = f"{abs(factor):.4g}·".removeprefix("1·")
                names[k] += f" {'+' if factor > 0 else '−'} {size}{self.labels[column]}"
        return tuple(names)

    @property
    def kept_labels(self) -> tuple[str, ...]:
        """Short names: the labels of the kept parameters, length b."""
        return tuple(self.labels[k] for k in self.kept)

    def with_values(self, values: Array) -> BaseParameters:
        """The same combinations with other values, shape (b,)."""
        return replace(self, values=np.array(values, dtype=float))

    def standard(self) -> Array:
        """Standard parameters with these base values, shape (p,).

        The dropped ones are zero: they give the right torque, but no physical body.
        """
        full = np.zeros(len(self.labels))
        full[list(self.kept)] = self.values
        return full

    @cached_property
    def dropped(self) -> dict[str, str]:
        """Labels of dropped parameters, and of the kept ones that they combine with.

        The second text is empty if the parameter never changes any torque.
        """
        found = {}
        for column, label in enumerate(self.labels):
            if column not in self.kept:
                size = np.abs(self.mapping[:, column])
                joined = np.flatnonzero(size > _NEGLIGIBLE * size.max(initial=0.0))
                found[label] = ", ".join(self.labels[self.kept[k]] for k in joined)
        return found


def inertial_labels(n: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the 10n inertial parameters, e.g. ``"mx_2"``."""
    names = tuple(f"{x}_{k + 1}" for k in range(n) for x in INERTIAL_NAMES)
    return names, INERTIAL_UNITS * n


def base_parameters(
    stacked: Array, labels: tuple[str, ...], units: tuple[str, ...]
) -> BaseParameters:
    """Base parameters of stacked columns (rigid body and effects together).

    A column that depends on earlier ones is dropped, so the order of the columns
    decides which of several equivalent parameters is kept.

    The columns are those on a motion that excites everything, shape (rows, p), with a
    name and a unit for each.
    """
    norms = np.linalg.norm(stacked, axis=0)
    zero = norms <= norms.max() * 1e-12
    scale = np.where(zero, 1.0, norms)
    unit = np.where(zero, 0.0, stacked / scale)
    R: Array = np.asarray(np.linalg.qr(unit, mode="r"))
    kept: list[int] = []
    # The diagonal of R shows dependence only while earlier columns are independent. So
    # the basis grows column by column.
    basis = np.zeros((R.shape[0], 0))
    for column in range(R.shape[1]):
        rest = R[:, column] - basis @ (basis.T @ R[:, column])
        rest -= basis @ (basis.T @ rest)
        size = np.linalg.norm(rest)
        if size > _RANK_TOLERANCE:
            basis = np.column_stack([basis, rest / size])
            kept.append(column)
    R = basis.T @ R
    mapping = np.asarray(solve_triangular(R[:, kept], R))
    # Rounding errors are compared in columns of unit length: in SI units 1e-6 may be
    # the m·d² of links one millimetre apart.
    mapping[np.abs(mapping) < _ROUNDING] = 0.0
    mapping[:, kept] = np.eye(len(kept))
    mapping = mapping * scale / scale[kept, None]
    return BaseParameters(labels, units, tuple(kept), mapping, np.zeros(len(kept)))
