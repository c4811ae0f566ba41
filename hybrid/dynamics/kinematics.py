"""Placement of the links of a chain."""

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.robot.chain import Chain


def frames(chain: Chain, q: Array) -> tuple[Array, Array, Array]:
    """Orientation, origin and joint axis of each link in the base frame.

    Positions q have shape (N, n), [rad]; the results have shapes (n, N, 3, 3),
    (n, N, 3) and (n, N, 3).
    """
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    found = []
    for k in range(chain.size):
        p = p + R @ chain.translation[k]
        R = R @ chain.rotation[k]
        axis = R @ chain.axis[k]
        if chain.revolute[k]:
            R = R @ Rotation.from_rotvec(q[:, k, None] * chain.axis[k]).as_matrix()
        else:
            p = p + axis * q[:, k, None]
        found.append((R, p, axis))
    turns, origins, axes = map(np.stack, zip(*found, strict=True))
    return turns, origins, axes
