"""Torque that a drive delivers, where a file lacks friction and rotor of its joint."""

import numpy as np

from hybrid.arrays import Array, Mask

_MOVING = 0.05  # of the highest speed; at rest friction balances any torque
_FEWEST_SAMPLES = 100  # for a fit


def moving(v: Array) -> Mask:
    """Samples at which a joint moves, by its speed in rad/s, shape (N,)."""
    return np.asarray(np.abs(v) > _MOVING * np.abs(v).max(initial=0.0))


def delivered_torque(
    v: Array, a: Array, tau: Array, asked: Array, use: Mask, *lost: Array
) -> Array:
    """The file's torque plus friction and rotor that the file may lack, shape (N,).

    With too few samples for a fit it is the file's torque.

    Args:
        v: Speed of the joint, shape (N,), [rad/s].
        a: Its acceleration, shape (N,), [rad/s²].
        tau: Torque of the file, shape (N,), [N·m].
        asked: Commanded torque, shape (N,), [N·m].
        use: Samples to which friction and rotor are fitted, shape (N,).
        lost: Further terms of the fit, shape (N,) each: torque that the drive loses.
    """
    laws = np.stack([np.sign(v), v, a, *lost], axis=1)
    residual = asked - tau
    use = use & np.isfinite(residual)
    if use.sum() < _FEWEST_SAMPLES:
        return tau
    gains = np.linalg.lstsq(laws[use], residual[use], rcond=None)[0]
    return np.asarray(tau + laws[:, :3] @ gains[:3])
