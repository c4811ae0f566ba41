"""Measurements of an arm at rest: poses, points or distances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.errors import CalibrationError

_SHAPES = {"q": "N, n", "position": "N, r, 3", "rotation": "N, 3, 3",
           "distance": "N, s"}  # fmt: skip


@dataclass(frozen=True)
class Measurements:
    """Measurements in N static poses; NaN where nothing was measured.

    Either points on the flange (reflectors), the first with an orientation if that was
    measured too, or distances of one point from fixed stations.

    Attributes:
        q: Joint positions, shape (N, n), [rad or m].
        position: Points, shape (N, r, 3), in the instrument's frame, [m]; r may be 0.
        rotation: Orientation of the tool, shape (N, 3, 3), or None.
        distance: Distance from each station, shape (N, s), [m]; s may be 0.
        source: File name for messages.
    """

    q: Array
    position: Array
    rotation: Array | None = None
    distance: Array | None = None
    source: str = "measurements"

    def __post_init__(self) -> None:
        sizes = {"N": len(self.q), "3": 3}
        for name, letters in _SHAPES.items():
            found, valid = np.shape(getattr(self, name)), letters.split(", ")
            wanted = [sizes.get(w, x) for x, w in zip(found, valid, strict=False)]
            if found and ([*found] != wanted or len(found) != len(valid)):  # () of None
                raise CalibrationError(
                    f"{self.source}: {name} has shape {found}, valid is ({letters})"
                )
        if self.rotation is not None and self.reflectors != 1:
            raise CalibrationError(
                f"{self.source}: an orientation goes with one point, not with "
                f"{self.reflectors}"
            )
        if bool(self.reflectors) == bool(self.stations):
            raise CalibrationError(
                f"{self.source}: {self.reflectors} points and {self.stations} "
                "distances; valid are points or distances, not both"
            )
        if not np.isfinite(self.q).all():
            row = int(np.flatnonzero(~np.isfinite(self.q).all(axis=1))[0])
            raise CalibrationError(
                f"{self.source}: pose {row + 1} has a joint position that is no number"
            )

    @property
    def size(self) -> int:
        """Number of poses N."""
        return len(self.q)

    @property
    def reflectors(self) -> int:
        """Number of measured points r on the flange."""
        return int(self.position.shape[1])

    @property
    def stations(self) -> int:
        """Number of stations s of a distance meter."""
        return 0 if self.distance is None else self.distance.shape[1]

    @property
    def kind(self) -> str:
        """Kind of the measurements: ``pose``, ``position`` or ``distance``."""
        if self.stations:
            return "distance"
        return "position" if self.rotation is None else "pose"

    def at(self, rows: Index | Mask) -> Measurements:
        """Some of the poses."""
        some: dict[str, Any] = {name: getattr(self, name) for name in _SHAPES}
        some = {name: x if x is None else x[rows] for name, x in some.items()}
        return replace(self, **some)
