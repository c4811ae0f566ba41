"""The health of a stream of samples: counts, rate, problems."""

from __future__ import annotations

from dataclasses import dataclass

_LOST = 0.01  # of the samples of the last second
_RATE_OFF = 0.05  # of the stated rate


@dataclass(frozen=True)
class Health:
    """Counts of accepted and rejected samples, and the rate.

    ``received`` is the sum of ``used`` and of those that were left out: ``not_finite``,
    ``implausible``, ``repeated``, ``late`` and ``jumped``.

    Attributes:
        received: Samples that came.
        used: Samples that were taken in.
        not_finite: They hold NaN or infinity.
        implausible: No drive moves so fast, or has such a torque.
        repeated: They have the stamp, or the values, of the sample before.
        late: Their stamp lies before one that was taken in.
        jumped: Their stamp lies further ahead than a gap that can be bridged.
        missing: Samples that never came, by the stamps of those that did.
        restarts: Times that the clock, or the position, went on from elsewhere.
        lost: Share of the samples of about the last second that were left out or never
            came.
        rate: Samples per second by their stamps, [Hz].
        stated_rate: Samples per second that were promised, [Hz].
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
        return abs(self.stated_rate - self.rate) <= _RATE_OFF * self.stated_rate

    @property
    def ok(self) -> bool:
        """Whether hardly any sample is lost and the rate is as stated."""
        return self.lost <= _LOST and self.rate_is_right

    @property
    def summary(self) -> str:
        """The counts in one line; those that are 0 are left out."""
        names = (
            "not_finite", "implausible", "repeated", "late", "jumped", "missing",
            "restarts",
        )  # fmt: skip
        counts = ((name.replace("_", " "), getattr(self, name)) for name in names)
        found = [f"{count:,} {name}" for name, count in counts if count]
        return ", ".join([f"{self.used:,} of {self.received:,} samples used", *found])

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong, in words; empty if all is well."""
        found = []
        if not self.rate_is_right:
            found.append(
                f"samples come at {self.rate:.4g} Hz, not at {self.stated_rate:g} Hz"
            )
        if self.lost > _LOST:
            found.append(f"{self.lost:.0%} of the last second's samples are lost")
        return tuple(found)
