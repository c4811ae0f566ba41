"""One plant of the benchmark: what kind it is, and which draw of that kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from hybrid.errors import HybridError

# Short names of robots that thresholds of the diagnosis were tuned on.
TUNED = ("coman_like",)

# Kind of plant -> its part of a benchmark's cases.
STRATA = {
    "single": 0.4,  # one effect of the library
    "withheld": 0.15,  # one effect, which is then left out of the library
    "none": 0.1,  # no effect; the file's numbers are off
    "pair": 0.1,
    "triple": 0.04,
    "unknown": 0.08,  # an effect that no file describes
    "independent": 0.05,  # a library effect by other equations or another's code
    "poor": 0.05,  # one effect on slow motions of some joints only
    "command": 0.03,  # an effect that leaves no trace between motion and torque
}


@dataclass(frozen=True)
class Case:
    """Names one plant; everything about it is drawn from these by the generator.

    Attributes:
        robot: Robot file, or name of a public arm.
        stratum: One of ``STRATA``.
        index: Number within the stratum.
        seed: Seed of the whole benchmark.
    """

    robot: str
    stratum: str
    index: int
    seed: int

    @property
    def arm(self) -> str:
        """Short name of the robot."""
        return Path(self.robot).stem

    @property
    def key(self) -> str:
        """Name of the case, unique in a benchmark."""
        return f"{self.arm}-{self.stratum}-{self.index:03d}-s{self.seed}"

    def rng(self, *more: int) -> np.random.Generator:
        """Its own source of random numbers."""
        names = [crc32(x.encode()) for x in (self.arm, self.stratum)]
        return np.random.default_rng([self.seed, *names, self.index, *more])

    def deal(self, cards: Sequence[object]) -> int:
        """Index of the card that falls to this case when a shuffled deck is dealt.

        Cases of one stratum see each card once before any is seen twice.
        """
        names = [crc32(x.encode()) for x in (self.arm, self.stratum)]
        turn, place = divmod(self.index, len(cards))
        rng = np.random.default_rng([self.seed, *names, 2**31 + turn])
        return int(rng.permutation(len(cards))[place])


def plan(
    robots: Sequence[str],
    count: int,
    *,
    seed: int,
    strata: Sequence[str] | None = None,
) -> tuple[Case, ...]:
    """Cases of all robots and strata, alternating, so that any start is balanced.

    Args:
        robots: Robot files or names.
        count: Number of cases.
        seed: Seed of the benchmark.
        strata: Some of ``STRATA``; all by default.

    Raises:
        HybridError: There is no such stratum.
    """
    for name in strata or ():
        if name not in STRATA:
            raise HybridError(f"no stratum {name!r}; valid are {', '.join(STRATA)}")
    parts = {name: STRATA[name] for name in strata or STRATA}
    whole = sum(parts.values())
    given = dict.fromkeys(parts, 0)
    cases = []
    for k in range(count):
        # Whichever stratum is furthest behind its part comes next.
        name = max(parts, key=lambda x: parts[x] / whole * (k + 1) - given[x])
        index, robot = divmod(given[name], len(robots))
        cases.append(Case(robots[robot], name, index, seed))
        given[name] += 1
    return tuple(cases)
