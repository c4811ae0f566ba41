"""One plant of the benchmark: what kind it is, and which draw of that kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

# Stratum -> what its plants are like.
STRATA = {
    "single": "one effect of the library",
    "withheld": "one effect, which is then left out of the library",
    "none": "no effect; the file's numbers are off",
    "pair": "two effects",
    "triple": "three effects",
    "unknown": "an effect that no file describes",
    "independent": "a library effect in an independent implementation of its physics",
    "poor": "one effect on slow motions of some joints only",
    "command": "an effect that leaves no trace between motion and torque",
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
    robots: Sequence[str], counts: dict[str, int], *, seed: int
) -> tuple[Case, ...]:
    """Cases of all robots and strata, alternating, so that any start is balanced.

    Args:
        robots: Robot files or names.
        counts: Number of cases of each stratum, over all robots.
        seed: Seed of the benchmark.
    """
    cases = [
        ((k + 0.5) / count, Case(robots[k % len(robots)], name, k // len(robots), seed))
        for name, count in counts.items()
        for k in range(count)
    ]
    return tuple(case for _, case in sorted(cases, key=lambda x: x[0]))
