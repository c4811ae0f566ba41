"""Safe motions of an arm: within its limits, with links that stay apart."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hybrid.errors import ExcitationError, HybridWarning, RobotError
from hybrid.excitation.clearance import Clearance
from hybrid.excitation.constraints import Limits
from hybrid.excitation.experiments import checked, path_from_reference
from hybrid.plant.reference import Reference
from hybrid.robot import Robot

_SAME_POSTURE = 0.01  # rad or m
_TRIES = 12


@dataclass(frozen=True, eq=False)
class Envelope:
    """80 % of the limits in a robot file, and the clearance of its links."""

    robot: Robot
    limits: Limits
    # Clearance of 1 cm between links; None if the file has no geometry.
    clearance: Clearance | None

    @classmethod
    def of(cls, robot: Robot) -> Envelope:
        """Make the envelope of a robot."""
        limits, clearance = Limits.of(robot), None
        with warnings.catch_warnings(), suppress(RobotError):  # no geometry
            # Links that touch in most postures are left out.
            warnings.simplefilter("ignore", HybridWarning)
            clearance = Clearance.of(robot, limits)
        return cls(robot, limits, clearance)

    def first_safe(
        self, make: Callable[[int], Reference], robot: Robot | None = None
    ) -> Reference:
        """The first safe motion of tries from 0 on, of an arm that may have a payload.

        Raises:
            ExcitationError: No try is safe.
        """
        for k in range(_TRIES):
            try:
                return self.checked(make(k), robot)
            except ExcitationError as error:
                failed = error
        raise failed

    def checked(self, reference: Reference, robot: Robot | None = None) -> Reference:
        """The reference, if it is safe for the arm, which may have a payload.

        Raises:
            ExcitationError: A limit is exceeded, or two links come too close.
        """
        checked(robot or self.robot, reference, self.limits)
        if self.clearance is None or not len(self.clearance.pairs):
            return reference
        postures = np.round(reference.q / _SAME_POSTURE)
        _, first = np.unique(postures, axis=0, return_index=True)
        worst = self.clearance.excess(path_from_reference(reference).at(first))
        if (worst > 0).any():
            name = self.clearance.names[int(worst.max(axis=0).argmax())]
            raise ExcitationError(f"{name}; valid is a motion with more room")
        return reference
