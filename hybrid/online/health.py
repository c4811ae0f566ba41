"""The health of a sample stream: counts, rate, problems."""

from dataclasses import dataclass

_MOST_LOST = 0.01  # of the samples of the last second
_RATE_TOLERANCE = 0.05  # of the stated rate


@dataclass(frozen=True)
class Health:
    """Counts of accepted and rejected samples, and the rate.

    ``received`` is the sum of ``used`` and the rejected ones: ``not_finite``,
    ``implausible``, ``repeated``, ``late`` and ``jumped``.

    Attributes:
        received: Samples received.
        used: Samples accepted.
        not_finite: Rejected: contains NaN or infinity.
        implausible: Rejected: a speed or torque that no drive has.
        repeated: Rejected: time stamp, or values, of the previous sample.
        late: Rejected: time stamp before that of an accepted sample.
        jumped: Rejected: time stamp after a gap that cannot be bridged.
        missing: Samples never received, judged by the time stamps.
        restarts: Number of times that clock or position restarted elsewhere.
        lost: Share of samples rejected or missing in about the last second.
        rate: Samples per second by their time stamps, [Hz].
        stated_rate: Samples per second that the user stated, [Hz].
    """

    received: int = 0
    used: int = 0
    not_finite: int = 0
    implausible: int = 0
    repeated: int = 0
    late: int = 0
    jumped: int = 0
    missing: int = 0
    restarts: int = 0
    lost: float = 0.0
    rate: float = 0.0
    stated_rate: float = 0.0

    @property
    def rate_is_right(self) -> bool:
        """Whether samples come at the stated rate."""
        return abs(self.stated_rate - self.rate) <= _RATE_TOLERANCE * self.stated_rate

    @property
    def ok(self) -> bool:
        """Whether few samples are lost and the rate is as stated."""
        return not self.problems

    @property
    def summary(self) -> str:
        """All counts above zero, in one line."""
        names = (
            "not_finite", "implausible", "repeated", "late", "jumped", "missing",
            "restarts",
        )  # fmt: skip
        counts = ((name.replace("_", " "), getattr(self, name)) for name in names)
        found = [f"{count:,} {name}" for name, count in counts if count]
        return ", ".join([f"{self.used:,} of {self.received:,} samples used", *found])

    @property
    def problems(self) -> tuple[str, ...]:
        """The problems, in words; empty if there are none."""
        found = []
        if not self.rate_is_right:
            found.append(
                f"samples come at {self.rate:.4g} Hz, not at {self.stated_rate:g} Hz"
            )
        if self.lost > _MOST_LOST:
            found.append(f"{self.lost:.0%} of the last second's samples are lost")
        return tuple(found)
