"""Torque that a drive delivers, where a file lacks friction and rotor of its joint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.signals import Motion

_MOVING = 0.05  # of the highest speed; at rest friction balances any torque
_FEWEST_SAMPLES = 100  # for a fit


class Drive(NamedTuple):
    """Signals of the drive of one joint, shape (N,) each.

    Attributes:
        v: Speed, [rad/s].
        a: Acceleration, [rad/s²].
        tau: Torque of the file, [N·m].
        asked: Commanded torque, [N·m]; that of the file where it is not known.
    """

    v: Array
    a: Array
    tau: Array
    asked: Array

    @classmethod
    def of(cls, motion: Motion, j: int) -> Drive:
        """The drive of a joint along a motion."""
        asked = motion.tau if motion.asked is None else motion.asked
        return cls(*(x[:, j] for x in (motion.v, motion.a, motion.tau, asked)))

    @property
    def moving(self) -> Mask:
        """Samples at which the joint moves, shape (N,)."""
        return np.asarray(np.abs(self.v) > _MOVING * np.abs(self.v).max(initial=0.0))

    def delivered(self, use: Mask, *lost: Array) -> Array:
        """The file's torque plus friction and rotor that the file may lack, shape (N,).

        These are fitted to the samples ``use``, shape (N,), beside further terms of
        torque that the drive loses. With too few samples it is the file's torque.
        """
        laws = np.stack([np.sign(self.v), self.v, self.a, *lost], axis=1)
        residual = self.asked - self.tau
        use = use & np.isfinite(residual)
        if use.sum() < _FEWEST_SAMPLES:
            return self.tau
        gains = np.linalg.lstsq(laws[use], residual[use], rcond=None)[0]
        return np.asarray(self.tau + laws[:, :3] @ gains[:3])
