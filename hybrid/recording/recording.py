"""The joint log of one recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording.reading import Reading

CHANNELS = ("q", "tau", "v", "command", "temperature")


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Joint log of a controller, on one clock.

    Attributes:
        t: Time, strictly increasing, shape (N,), [s].
        q: Joint position, shape (N, n), [rad or m].
        tau: Drive torque at the joint, shape (N, n), [N·m or N]; NaN throughout if it
            was not measured.
        v: Measured joint speed, shape (N, n), [rad/s], or None.
        command: Commanded joint position, shape (N, n), [rad], or None.
        temperature: Drive temperature, shape (N, n), [°C], or None.
        joints: Joint names in column order, length n; ``joint_1`` ... if not given.
        source: File or folder, for messages.
        reading: Report of how it was read; None if it is not from a file or table.

    Raises:
        RecordingError: Shapes disagree, a sample is not finite, or time does not
            increase; the message names the channel and the first bad row.
    """

    t: Array
    q: Array
    tau: Array = field(default_factory=lambda: np.zeros(0))
    v: Array | None = None
    command: Array | None = None
    temperature: Array | None = None
    joints: tuple[str, ...] = ()
    source: str = ""
    reading: Reading | None = None

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        for name in ("t", *CHANNELS):
            if getattr(self, name) is not None or name in ("t", "q", "tau"):
                set_field(self, name, self._array(name, getattr(self, name)))
        if self.q.ndim != 2 or self.q.shape[1] == 0:
            raise self._error(f"q has shape {self.q.shape}; valid is (N, n), n ≥ 1")
        if not self.has_torque:
            set_field(self, "tau", np.full_like(self.q, np.nan))
        if isinstance(self.joints, str) or not isinstance(self.joints, Iterable):
            valid = "valid are names, one for each column"
            raise self._error(f"joints is {self.joints!r}; {valid}")
        names = tuple(str(joint) for joint in self.joints)
        set_field(self, "joints", names or numbered_joints(self.q.shape[1]))
        self._check_shapes()
        self._check_samples()
        self._check_clock()

    @property
    def has_torque(self) -> bool:
        """Whether torque was measured."""
        return not np.isnan(self.tau).all()

    @property
    def size(self) -> int:
        """Number of joints n."""
        return int(self.q.shape[1])

    @property
    def rate(self) -> float:
        """Samples per second, from the median step, [Hz]."""
        return float(1.0 / np.median(np.diff(self.t)))

    @property
    def duration(self) -> float:
        """Time from first to last sample, [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def channels(self) -> dict[str, Array]:
        """Joint channels of the log by name, each of shape (N, n)."""
        present = {name: getattr(self, name) for name in CHANNELS}
        present["tau"] = self.tau if self.has_torque else None
        return {name: x for name, x in present.items() if x is not None}

    def __eq__(self, other: object) -> bool:
        """Tell whether joints, clock and samples are equal; the source may differ."""
        if not isinstance(other, Recording):
            return NotImplemented
        return (
            self.joints == other.joints
            and np.array_equal(self.t, other.t)
            and self.channels.keys() == other.channels.keys()
            and all(
                np.array_equal(x, other.channels[k]) for k, x in self.channels.items()
            )
        )

    def __repr__(self) -> str:
        return (
            f"<Recording {self.source}: {self.duration:.3g} s, {len(self.t):,} samples "
            f"of {', '.join(self.channels)} of {', '.join(self.joints)}>"
        )

    __hash__ = None  # type: ignore[assignment]

    def in_order(self, joints: tuple[str, ...]) -> Recording:
        """Return the log with its joints in this order; numbered joints get the names.

        Raises:
            RecordingError: Joints are missing or unknown; both are listed.
        """
        if self.joints == joints:
            return self
        if sorted(self.joints) == sorted(joints):
            order = [self.joints.index(joint) for joint in joints]
            channels = {name: x[:, order] for name, x in self.channels.items()}
            return replace(self, joints=joints, **channels)  # type: ignore[arg-type]
        if self.joints == numbered_joints(self.size):
            if self.size == len(joints):
                return replace(self, joints=joints)
            raise self._error(
                f"{self.size} joints; valid are {len(joints)}: {', '.join(joints)}"
            )
        raise self._error(joint_mismatch(self.joints, joints))

    def place(self, channel: str, joint: int, row: int | None = None) -> str:
        """Name a column and a row for messages, which count both from 1."""
        where = f"{channel}{joint + 1} ({self.joints[joint]})"
        return where if row is None else f"{where}, {row_words(row)}"

    def _error(self, text: str) -> RecordingError:
        return RecordingError(f"{self.source or 'recording'}: {text}")

    def _array(self, name: str, value: ArrayLike) -> Array:
        try:
            return np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise self._error(f"{name} is not an array of numbers: {error}") from error

    def _check_shapes(self) -> None:
        if self.t.ndim != 1 or len(self.t) < 2:
            raise self._error(
                f"t has shape {self.t.shape}; valid is one column of two rows or more"
            )
        shape = (len(self.t), self.size)
        for name, x in self.channels.items():
            if x.shape != shape:
                raise self._error(
                    f"{name} has shape {x.shape}; valid is {shape}, a row for each "
                    "time and a column for each joint"
                )
        if len(self.joints) != self.size or len(set(self.joints)) != self.size:
            raise self._error(
                f"joints are {', '.join(self.joints)}; valid are {self.size} names, "
                "all different, one for each column of q"
            )

    def _check_samples(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.t))
        if bad.size:
            raise self._error(f"t, {row_words(bad[0])}: {_not_finite(self.t[bad[0]])}")
        for name, x in self.channels.items():
            if np.isfinite(x).all():
                continue
            row, joint = np.argwhere(~np.isfinite(x))[0]
            if np.isnan(x[:, joint]).all():
                raise self._error(
                    f"{self.place(name, joint)}: no number in any row; valid are "
                    "numbers, or, if that joint stood still, an arm without it: "
                    "--joints"
                )
            raise self._error(
                f"{self.place(name, joint, row)}: {_not_finite(x[row, joint])}"
            )

    def _check_clock(self) -> None:
        bad = np.flatnonzero(np.diff(self.t) <= 0)
        if bad.size:
            row = int(bad[0]) + 1
            before, now = float(self.t[row - 1]), float(self.t[row])
            what = "is repeated" if now == before else f"goes back from {before!r}"
            raise self._error(
                f"t, {row_words(row)}: time {now!r} s {what}; valid is time that "
                "increases from row to row"
            )


def numbered_joints(size: int) -> tuple[str, ...]:
    """Names of joints that have only a number: ``joint_1`` to ``joint_n``."""
    return tuple(f"joint_{k + 1}" for k in range(size))


def row_words(row: int) -> str:
    """Name a row, given by its index from 0, for messages."""
    return f"row {row + 1} (data rows count from 1)"


def joint_mismatch(found: tuple[str, ...], joints: tuple[str, ...]) -> str:
    """Line for messages that lists missing, unknown and valid joints."""
    missing = [joint for joint in joints if joint not in found]
    unknown = [joint for joint in found if joint not in joints]
    parts = [f"missing joints: {', '.join(missing)}"] if missing else []
    parts += [f"unknown joints: {', '.join(unknown)}"] if unknown else []
    valid = ", ".join(joints)
    if 0 < len(missing) < len(joints):
        valid += ", or, if the missing ones stood still, an arm without them: --joints"
    return f"{'; '.join(parts)}; valid are {valid}"


def _not_finite(value: float) -> str:
    return (
        f"value {value} is not a finite number (an empty cell reads as nan); leave out "
        "such rows: a log with gaps counts as several"
    )
