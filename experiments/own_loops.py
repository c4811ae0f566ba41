"""Does the diagnosis name the fault of a MuJoCo loop that somebody else might write?

One fault of each kind, of usual size and at a random joint, on several arms: four logs
of 10 s each; see ``own_loop``. Masses and friction of the file are off by up to 2 %. A
table of arms and kinds appears: whether the fault was named first and alone, was in the
class that was named, or what was said instead. With --bare the file declares neither
friction nor rotors, as most do: these have to be found at every joint besides.

    python experiments/own_loops.py --arms models/scara.xml,ur5,panda --seed 1 [--bare]
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from blind.robots import load_arm
from outputs import captioned, command_line, write_tables
from own_fault import KINDS, Fault
from own_loop import OwnLoop
from own_motion import Make
from rich.console import Console

from hybrid import Diagnosis, diagnose
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.errors import HybridWarning, RecordingError
from hybrid.plant import random_fourier
from hybrid.report import (
    Table,
    terminal_table,
)
from hybrid.robot import Robot
from hybrid.shown import plain

RECORDINGS = 4
# Parameters that a bare file declares as zero, as MuJoCo calls them.
LEFT_OUT = {"coulomb": "frictionloss", "viscous": "damping", "armature": "armature"}


def bare(robot: Robot) -> Robot:
    """The arm as a file that declares neither friction nor rotors."""
    none = 0.0 * robot.damping
    chain = replace(robot.chain, armature=none)
    return replace(robot, chain=chain, damping=none, frictionloss=none)


def run(
    arm: str,
    kinds: tuple[str, ...],
    seed: int,
    left_out: Collection[str] = (),
    without: Collection[str] = (),
    motion: Make = random_fourier,
) -> dict[str, Any]:
    """Log faults on one arm, and diagnose them."""
    loop = OwnLoop(load_arm(arm), kinds, seed, motion)
    logs = [loop.record() for _ in range(RECORDINGS)]
    robot, start = bare(loop.robot) if left_out else loop.robot, process_time()
    said = {
        "arm": Path(arm).stem, "true": loop.named, "joints": robot.joints,
        "sizes": sizes(arm, kinds, seed, motion),
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        try:
            found = diagnose(robot, logs, without=tuple(without))
        except RecordingError as error:  # a right log, so it counts as a miss
            return said | {
                "verdict": "refused", "named": [], "relative": None, "unseen": None,
                "error": str(error), "cpu_s": process_time() - start,
            }  # fmt: skip
    return said | {
        "verdict": found.verdict,
        "named": named(found), "intervals": intervals(found, loop, left_out),
        "relative": found.relative,
        "unexplained": found.unexplained,
        "unseen": found.unseen and plain(asdict(found.unseen)),
        "cpu_s": process_time() - start,
    }  # fmt: skip


@lru_cache(maxsize=1)  # a plant is diagnosed with and without an effect
def sizes(
    arm: str, kinds: tuple[str, ...], seed: int, motion: Make = random_fourier
) -> list[float]:
    """What each fault adds to the gap, at most at a joint, in units of noise.

    The noise is the gap of the loop without faults, small errors of its file included.
    The gap is of the motion that is driven: that a fault changes the motion is none.
    Beside another fault one may never act: a drive that saturates without a spring.
    """
    every = OwnLoop(load_arm(arm), kinds, seed, motion)

    def squares(only: Collection[int]) -> np.ndarray:
        loop = OwnLoop(load_arm(arm), kinds, seed, motion, only)
        for k, fault in zip(only, loop.faults, strict=True):
            fault.limit = every.faults[k].limit
        loop.rng = deepcopy(every.rng)  # motions and noise that are diagnosed
        gap = measure_gap(loop.robot, [loop.record() for _ in range(RECORDINGS)])
        used = np.maximum(gap.moving.sum(axis=0), 1)
        return (np.where(gap.moving, gap.left, 0.0) ** 2).sum(axis=0) / used

    numbers = range(len(kinds))
    noise, whole = squares(()), squares(numbers)
    others = [[i for i in numbers if i != k] for k in numbers]
    less = [squares(x) if x else noise for x in others]
    more = [np.maximum(whole - x, 0.0) for x in less]
    least = np.where(noise > 0, noise, np.inf)  # no noise where a joint does not move
    return [float(np.sqrt((x / least).max())) for x in more]


def named(found: Diagnosis) -> list[dict[str, Any]]:
    """What a diagnosis names."""
    return [
        {
            "effect": f.effect,
            "joints": f.joints,
            "class": f.alternatives,
            "chances": f.chances,
            "probability": plain(f.probability),
        }
        for f in found.findings
    ]


def intervals(
    found: Diagnosis, loop: OwnLoop, left_out: Collection[str] = ()
) -> list[list[Any]]:
    """Effect, parameter, true value and 95 % interval of each that is known.

    Of what the file leaves out, the plant's whole value is true, and not the fault's.
    """
    return [
        [f.effect, x.name, _true(loop, fault, x.name, left_out), *x.interval]
        for fault in loop.faults
        for f in found.findings
        for x in f.parameters
        if f.effect == fault.kind and x.joint == loop.robot.joints[fault.j]
        if x.name in fault.values
    ]


def _true(loop: OwnLoop, fault: Fault, name: str, left_out: Collection[str]) -> float:
    """True value of a parameter of the effect that a fault is."""
    if fault.kind not in left_out:
        return fault.values[name]
    every = getattr(loop.model, f"dof_{LEFT_OUT[fault.kind]}")
    return float(every[loop.at_v[fault.j]])


def outcome(found: dict[str, Any], left_out: Collection[str] = ()) -> str:
    """What the answer is worth, where there is one fault."""
    ((kind, joint),), named = found["true"], found["named"]
    if not named:
        right = kind == "none" and found["verdict"] == "no_gap"
        return "right" if right else found["verdict"]
    named = [x for x in named if x["effect"] not in left_out or x["effect"] == kind]
    if not named:
        return "right" if kind == "none" else "not found"
    first, rest = named[0], named[1:]
    if kind not in first["class"] or joint not in first["joints"]:
        return f"named {first['effect']}"
    word = "right" if first["effect"] == kind else f"in class ({first['effect']})"
    return word + "".join(f", and {x['effect']}" for x in rest)


def main() -> None:
    """Run all kinds on all arms, print the table, write the report."""
    parser = command_line(__doc__, "own_loops")
    parser.add_argument("--arms", default="models/scara.xml,ur5,panda")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bare", action="store_true", help="no friction in the file")
    parser.add_argument("--workers", type=int, default=2)
    args, console = parser.parse_args(), Console(width=160)
    arms, runs, left_out = args.arms.split(","), [], LEFT_OUT if args.bare else ()
    with ProcessPoolExecutor(args.workers) as pool:
        for arm in arms:
            each = partial(run, arm, seed=args.seed, left_out=left_out)
            for found in pool.map(each, [(kind,) for kind in KINDS]):
                runs.append(found | {"outcome": outcome(found, left_out)})
                said = found["true"], runs[-1]["outcome"]
                console.print(arm, *said, highlight=False)
    by_arm = [[r for r in runs if r["arm"] == Path(arm).stem] for arm in arms]
    outcomes = list(
        zip(*([r["outcome"] for r in rows] for rows in by_arm), strict=True)
    )
    table = Table(
        ("", *(Path(arm).stem for arm in arms)),
        tuple((kind, *row) for kind, row in zip(KINDS, outcomes, strict=True)),
        "What is said of one fault of each kind"
        + ", of a file without friction and rotors" * args.bare,
        words=True,
    )
    count = Counter(short(r["outcome"]) for r in runs)
    command = f"python experiments/own_loops.py --arms {args.arms} --seed {args.seed}"
    command += " --bare" * args.bare
    write_report(args.out, table, counted(count), command, runs)


def by_condition(
    runs: Sequence[Sequence[dict[str, Any]]], conditions: Sequence[str], arm: str
) -> tuple[Table, str]:
    """A table of kinds and conditions, and how often each outcome came in each.

    Args:
        runs: For each kind, what is said under each condition.
        conditions: Their names.
        arm: Name of the arm.
    """
    table = Table(
        ("", *conditions),
        tuple((r[0]["true"][0][0], *(x["outcome"] for x in r)) for r in runs),
        f"What is said of one fault of each kind on {Path(arm).stem}",
        words=True,
    )
    counts = [Counter(short(x["outcome"]) for x in c) for c in zip(*runs, strict=True)]
    lines = zip(conditions, map(counted, counts), strict=True)
    return table, "\n".join(f"- {name}: {count}" for name, count in lines)


def short(outcome: str) -> str:
    """An outcome without the names of effects."""
    first, *more = outcome.split(", and ")
    return first.split(" (")[0] + " with something false" * bool(more)


def counted(count: Counter[str]) -> str:
    """How often each outcome came, in words."""
    return "; ".join(f"{name}: {n}" for name, n in count.most_common())


def write_report(
    folder: Path, table: Table, summary: str, command: str, runs: Sequence[Any]
) -> None:
    """Print a table with its summary, and write it with all runs."""
    Console(width=200).print(terminal_table(table), summary, highlight=False)
    write_tables(folder, f"{captioned(table)}\n{summary}\n", command, runs=runs)


if __name__ == "__main__":
    main()
