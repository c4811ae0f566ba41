"""Condition numbers of the rigid body, in columns that are named.

Of the inertial parameters only combinations can be told, and which parameters stand for
them is a choice: the same motion has another condition number in each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from hybrid.dynamics import RigidBody, regressor, stacked_base
from hybrid.dynamics.stacked import rich_motion
from hybrid.excitation.path import Path
from hybrid.robot.chain import Array, Chain

FIRST = "first independent columns"
PIVOTED = "columns by pivoted QR"


def condition(H: Array, columns: Sequence[int]) -> float:
    """Condition number of an observation matrix in some of its columns.

    Args:
        H: Observation matrix, shape (rows, p).
        columns: Indices of independent columns.
    """
    return float(np.linalg.cond(H[:, list(columns)]))


def rigid_columns(chain: Chain) -> dict[str, tuple[int, ...]]:
    """Choices of columns among the 10n of the regressor, by name.

    ``first independent columns`` goes from the base to the tip and keeps what the
    columns before cannot express. ``columns by pivoted QR`` takes the largest remaining
    one each time, on a motion that excites everything: the same columns for every
    design of an arm.
    """
    kept = stacked_base(chain, (), ()).kept
    rich = RigidBody(chain, rich_motion(chain)).columns
    _, order = qr(rich.reshape(-1, rich.shape[2]), mode="r", pivoting=True)
    return {FIRST: kept, PIVOTED: tuple(int(k) for k in order[: len(kept)])}


def rigid_conditions(chain: Chain, path: Path) -> dict[str, float]:
    """Condition number of a motion in each of the named columns, SI units.

    Args:
        chain: The arm.
        path: Motion, N samples.
    """
    H = regressor(chain, path.q, path.v, path.a).reshape(-1, 10 * chain.size)
    return {name: condition(H, at) for name, at in rigid_columns(chain).items()}
