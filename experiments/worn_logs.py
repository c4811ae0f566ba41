"""Does the diagnosis still name the fault where the logs are worse than usual?

Logs of ``own_loop``, one fault of each kind, and the same logs slower, noisier,
coarser, with time stamps that jitter, with holes, or only the first of the four. A
table of kinds and logs appears, with the outcomes of ``own_loops``.

    python experiments/worn_logs.py --arm models/scara.xml --seed 5
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from time import process_time
from typing import Any

import numpy as np
from blind.robots import load_arm
from outputs import command_line
from own_fault import KINDS
from own_loop import OwnLoop
from own_loops import RECORDINGS, by_condition, named, outcome, write_report
from rich.console import Console

from hybrid import diagnose
from hybrid.errors import HybridWarning
from hybrid.recording import Recording

EACH = 5  # samples of 500 Hz to one of 100 Hz
NOISE, STEP = 0.02, 0.005  # of the rated torque
COUNT = 1.5e-3  # rad, of an encoder of 4096 lines
JITTER = 0.2  # of a sample's time, to either side
HOLES, HOLE, LOST = 3, 100, 0.02  # in a log; samples of each; share of the others


def rows(log: Recording, keep: Any) -> Recording:
    """Some samples of a log."""
    channels = {name: x[keep] for name, x in log.channels.items()}
    return replace(log, t=log.t[keep], **channels)


def noisy(log: Recording, rated: np.ndarray, rng: np.random.Generator) -> Recording:
    """Torque from a noisy current that is read in coarse steps."""
    tau = log.tau + NOISE * rated * rng.standard_normal(log.tau.shape)
    return replace(log, tau=np.round(tau / (STEP * rated)) * STEP * rated)


def stamped(log: Recording, rng: np.random.Generator) -> Recording:
    """Samples at regular times, stamped a little early or late."""
    off = rng.uniform(-JITTER, JITTER, len(log.t))
    return replace(log, t=log.t + off * np.median(np.diff(log.t)))


def holed(log: Recording, rng: np.random.Generator) -> Recording:
    """Without some samples here and there, and some stretches of 0.2 s."""
    keep = rng.random(len(log.t)) > LOST
    for first in rng.integers(2 * HOLE, len(log.t) - 3 * HOLE, HOLES):
        keep[first : first + HOLE] = False
    return rows(log, keep)


WEAR: dict[str, Callable[[Sequence[Recording], np.ndarray, Any], list[Recording]]] = {
    "as they are": lambda logs, rated, rng: list(logs),
    "100 Hz": lambda logs, rated, rng: [rows(x, slice(0, None, EACH)) for x in logs],
    "noisy torque": lambda logs, rated, rng: [noisy(x, rated, rng) for x in logs],
    "coarse encoder": lambda logs, rated, rng: [
        replace(x, q=COUNT * np.round(x.q / COUNT)) for x in logs
    ],
    "jittering stamps": lambda logs, rated, rng: [stamped(x, rng) for x in logs],
    "holes": lambda logs, rated, rng: [holed(x, rng) for x in logs],
    "one log": lambda logs, rated, rng: list(logs[:1]),
}


def run(arm: str, kind: str, seed: int) -> list[dict[str, Any]]:
    """Log one fault, and diagnose it from the logs as they are, and worse."""
    loop, found = OwnLoop(load_arm(arm), (kind,), seed), []
    logs = [loop.record() for _ in range(RECORDINGS)]
    for wear, change in WEAR.items():
        worn = change(logs, loop.rated, np.random.default_rng(seed))
        start = process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            said = diagnose(loop.robot, worn)
        answer = {
            "true": loop.named, "logs": wear, "verdict": said.verdict,
            "named": named(said), "cpu_s": process_time() - start,
        }  # fmt: skip
        found.append(answer | {"outcome": outcome(answer)})
    return found


def main() -> None:
    """Run all kinds, print the table, write the report."""
    parser = command_line(__doc__, "worn_logs")
    parser.add_argument("--arm", default="models/scara.xml")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    args, console = parser.parse_args(), Console(width=200)
    each, runs = partial(run, args.arm, seed=args.seed), []
    with ProcessPoolExecutor(args.workers) as pool:
        for found in pool.map(each, KINDS):
            runs.append(found)
            outcomes = [r["outcome"] for r in found]
            console.print(found[0]["true"][0], outcomes, highlight=False)
    table, summary = by_condition(runs, tuple(WEAR), args.arm)
    command = f"python experiments/worn_logs.py --arm {args.arm} --seed {args.seed}"
    write_report(args.out, table, summary, command, runs)


if __name__ == "__main__":
    main()
