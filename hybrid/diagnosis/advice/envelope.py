"""What an arm may safely do: its limits, and links that stay apart."""

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

_ALIKE = 0.01  # rad or m, between postures that need no second look
_TRIES = 12


@dataclass(frozen=True, eq=False)
class Envelope:
    """80 % of the limits of an arm's file, and the distance between its links.

    Attributes:
        robot: The arm.
        limits: The limits.
        clearance: The links, 1 cm apart; nothing where the file holds no geometry.
    """

    robot: Robot
    limits: Limits
    clearance: Clearance | None

    @classmethod
    def of(cls, robot: Robot) -> Envelope:
        """Take it from the robot's file."""
        limits, clearance = Limits.of(robot), None
        # Without geometry no link is known to touch another: limits are all there is.
        with warnings.catch_warnings(), suppress(RobotError):
            # Links that touch in most postures are left out here as well.
            warnings.simplefilter("ignore", HybridWarning)
            clearance = Clearance.of(robot, limits)
        return cls(robot, limits, clearance)

    def first_safe(
        self, make: Callable[[int], Reference], robot: Robot | None = None
    ) -> Reference:
        """The first of some motions that is safe.

        Args:
            make: Makes a motion from the number of the try, from 0.
            robot: The arm as it will be, such as one that carries something.

        Raises:
            ExcitationError: None is.
        """
        for k in range(_TRIES):
            try:
                return self.checked(make(k), robot)
            except ExcitationError as error:
                failed = error
        raise failed

    def checked(self, reference: Reference, robot: Robot | None = None) -> Reference:
        """The reference, if it is safe.

        Args:
            reference: A motion of the arm.
            robot: The arm as it will be; as it is by default.

        Raises:
            ExcitationError: A limit is exceeded, or two links come too close.
        """
        checked(robot or self.robot, reference, self.limits)
        if self.clearance is None or not len(self.clearance.pairs):
            return reference
        postures = np.round(reference.q / _ALIKE)
        _, first = np.unique(postures, axis=0, return_index=True)
        worst = self.clearance.excess(path_from_reference(reference).at(first))
        if (worst > 0).any():
            name = self.clearance.names[int(worst.max(axis=0).argmax())]
            raise ExcitationError(f"{name}; valid is a motion with more room")
        return reference
