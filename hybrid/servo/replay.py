"""One log beside what servos make of its commands."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.arrays import Array


@dataclass(frozen=True, eq=False)
class ServoReplay:
    """One log beside its replays, N samples.

    Attributes:
        t: Time, shape (N,), [s].
        command: Commanded position, shape (N, n), [rad].
        q: Measured position, shape (N, n), [rad].
        before: What the file's servos make of it, shape (N, n), [rad].
        after: What the servos found make of it, shape (N, n), [rad].
        source: Where the log is from.
    """

    t: Array
    command: Array
    q: Array
    before: Array
    after: Array
    source: str
