"""Online identification of a two-joint space robot with unknown payload and friction.

A table appears: true values, the published results, recursive differential evolution
in four variants over many runs (medians, quartiles and the best), plain searches and
least squares, and ours, tracked sample by sample, from the same offline start and from
half the payload with wrong friction. A figure shows the way of the searches.

    python experiments/space_robot_online.py --runs 50
"""

from __future__ import annotations

import numpy as np
from outputs import command_line
from space_robot import motion
from space_robot_ours import track, with_noise
from space_robot_report import write_report
from space_robot_searches import plain, recursive_search

from hybrid.robot.chain import Array

VARIANTS = {
    "best/2": ("best2bin", 0.0),
    "best/2, improved": ("best2bin", 0.02),
    "rand-to-best": ("randtobest1bin", 0.0),
    "rand-to-best, improved": ("randtobest1bin", 0.02),
}
NOISE = 0.01  # N·m


def tracked(data: tuple[Array, ...], runs: int) -> dict[str, tuple[Array, float]]:
    """Ours with and without noise and offline start: parameters, seconds a sample."""
    found = {}
    for label, noise in (("no noise", 0.0), (f"noise {NOISE} N·m", NOISE)):
        for way, offline in (("", True), (", no offline start", False)):
            each = [
                track(with_noise(data, noise, seed), noise, offline=offline)
                for seed in range(runs if noise else 1)
            ]
            seconds = float(np.median([x[-1] for x in each]))
            found[f"ours, {label}{way}"] = np.array([x[0] for x in each]), seconds
    return found


def main() -> None:
    """Run everything, print the table, write the report."""
    parser = command_line(__doc__, "space_robot")
    parser.add_argument("--runs", type=int, default=50)
    args, data = parser.parse_args(), motion()
    count: int = args.runs
    runs = {
        name: [recursive_search(data, seed, *options) for seed in range(count)]
        for name, options in VARIANTS.items()
    }
    write_report(args.out, runs, plain(data), tracked(data, count), f"--runs {count}")


if __name__ == "__main__":
    main()
