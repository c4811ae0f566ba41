"""Condition numbers of the rigid body for named choices of columns.

Of the inertial parameters only combinations can be told, and which parameters stand for
them is a choice: the same motion has another condition number in each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from hybrid.arrays import Array
from hybrid.dynamics import regressor, stacked_base
from hybrid.excitation.path import Path
from hybrid.robot.chain import Chain

FIRST = "first independent columns"
PIVOTED = "columns by pivoted QR"


def condition(H: Array, columns: Sequence[int]) -> float:
    """Condition number of an observation matrix in some of its columns.

    Args:
        H: Observation matrix, shape (rows, p).
        columns: Indices of independent columns.
    """
    return float(np.linalg.cond(H[:, list(columns)]))


def rigid_columns(chain: Chain, H: Array) -> dict[str, tuple[int, ...]]:
    """Choices of columns among the 10n of the regressor, by name.

    ``first independent columns`` goes from the base to the tip and keeps what the
    columns before cannot express, the same for every motion. ``columns by pivoted QR``
    takes the largest that remains each time.

    Args:
        chain: The arm.
        H: Observation matrix of all columns, shape (rows, 10n).
    """
    kept = stacked_base(chain, (), ()).kept
    _, order = qr(H, mode="r", pivoting=True)
    return {FIRST: kept, PIVOTED: tuple(int(k) for k in order[: len(kept)])}


def rigid_conditions(chain: Chain, path: Path) -> dict[str, float]:
    """Condition number of a motion in each of the named columns, SI units.

    Args:
        chain: The arm.
        path: Motion, N samples.
    """
    H = regressor(chain, path.q, path.v, path.a).reshape(-1, 10 * chain.size)
    return {name: condition(H, at) for name, at in rigid_columns(chain, H).items()}
