"""Online identification of a two-joint space robot with unknown payload and friction.

A table appears: true values, the published results, recursive differential evolution
in four variants over many runs (medians, quartiles and the best), a particle swarm,
recursive and over all samples at once, recursive least squares, plain searches and
least squares, and ours, tracked sample by sample, from the same offline start and from
half the payload with wrong friction. A second table, as the publication's fifth, has
the number of updates of each and the variance of every parameter over the runs, without
and with noise. A figure shows the way of the searches.

    python experiments/space_robot_online.py --runs 50
"""

from __future__ import annotations

from functools import partial

from outputs import command_line
from space_robot import motion
from space_robot_ours import track, with_noise
from space_robot_report import write_report
from space_robot_searches import (
    Run,
    plain,
    recursive_least_squares,
    recursive_search,
    swarm,
    swarm_at_once,
)

from hybrid.arrays import Array

VARIANTS = {
    "best/2": ("best2bin", 0.0),
    "best/2, improved": ("best2bin", 0.02),
    "rand-to-best": ("randtobest1bin", 0.0),
    "rand-to-best, improved": ("randtobest1bin", 0.02),
}
SWARMS = {
    "recursive swarm": swarm,
    "swarm, all samples at once": swarm_at_once,
    "the same, friction known": partial(swarm_at_once, size=4),
}
NOISE = 0.01  # N·m


def tracked(noise: float, data: tuple[Array, ...], count: int) -> dict[str, list[Run]]:
    """Ours with and without an offline start, each run with noise of its own."""
    logs = [with_noise(data, noise, seed) for seed in range(count if noise else 1)]
    return {
        f"ours{way}": [track(log, noise, offline=offline) for log in logs]
        for way, offline in (("", True), (", no offline start", False))
    }


def searched(noise: float, data: tuple[Array, ...], count: int) -> dict[str, list[Run]]:
    """All recursive methods of the literature, each run with noise of its own."""
    logs = [with_noise(data, noise, seed) for seed in range(count)]
    runs = {
        f"recursive DE, {name}": [
            recursive_search(log, seed, *options) for seed, log in enumerate(logs)
        ]
        for name, options in VARIANTS.items()
    }
    for name, search in SWARMS.items():
        runs[name] = [search(log, seed) for seed, log in enumerate(logs)]
    alike = logs if noise else logs[:1]  # nothing is left to chance
    runs["recursive least squares"] = [recursive_least_squares(log) for log in alike]
    return runs


def main() -> None:
    """Run everything, print the table, write the report."""
    parser = command_line(__doc__, "space_robot")
    parser.add_argument("--runs", type=int, default=50)
    args, data = parser.parse_args(), motion()
    count: int = args.runs
    runs = {
        label: searched(noise, data, count) | tracked(noise, data, count)
        for label, noise in (("no noise", 0.0), (f"noise {NOISE} N·m", NOISE))
    }
    write_report(args.out, runs, plain(data), f"--runs {count}")


if __name__ == "__main__":
    main()
