"""Does the advised experiment split the candidates that the recordings could not?

The COMAN-like arm with one effect is recorded in one short and slow motion, so that
other effects explain it as well. The diagnosis advises an experiment; the true arm runs
it, and both are diagnosed together. A table of all pairs appears: split if they are in
one class no more, and rightly so if the true effect is still named.

    python experiments/advice.py --seeds 1
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from advice_report import write_report
from rich.console import Console

from hybrid import Effect, Robot
from hybrid.diagnose.advise import advise
from hybrid.diagnose.diagnose import Result, examine
from hybrid.effects import effect_classes
from hybrid.plant import Plant, random_fourier
from hybrid.plant.reference import Reference
from hybrid.plant.scale import joint_scales

MODEL = Path(__file__).parents[1] / "models" / "coman_like.xml"
JOINTS = {"coulomb": 0, "viscous": 0, "delay": 2, "actuator_lag": 4, "spring": 5,
          "presliding": 3, "torque_offset": 3, "deadzone": 4}  # fmt: skip
SIZES, FILL, SECONDS, RATE = (0.15, 0.5), 0.3, 10.0, 500.0


def true_effect(robot: Robot, effect_id: str, size: float) -> Effect:
    """An effect of which a short and slow motion may show too little."""
    cls = effect_classes()[effect_id]
    usual = cls.typical((JOINTS[effect_id],), joint_scales(robot))
    return usual.at({g.name: size * usual.values[g.name] for g in cls.gains})


def class_at(result: Result, joint: str) -> set[str]:
    """Ids that the diagnosis cannot tell apart at a joint."""
    found = (f for f in result.diagnosis.findings if joint in f.joints)
    return {x for f in found for x in f.alternatives}


def measure(robot: Robot, true: Effect, seed: int) -> list[dict[str, Any]]:
    """Pairs of the true effect and a rival, before and after the advised experiment."""
    rng = np.random.default_rng([seed, sum(map(ord, true.id))])
    plant, name = Plant(robot, [true], nominal=robot), robot.joints[true.joints[0]]
    short = random_fourier(robot, duration=SECONDS, rate=RATE, rng=rng, fill=FILL)
    logs, pairs = plant.run([short], rng=rng), []
    with TemporaryDirectory() as folder:
        for advice in advise(examine(robot, logs), rng, directory=folder):
            if true.id not in advice.splits:
                continue
            row: dict[str, Any] = {"true": true.id, "joint": name, "seed": seed}
            row |= {"advice": advice.experiment, "separation": advice.separation}
            after = {*advice.splits}
            if advice.file:
                path = Path(folder) / advice.file
                table = np.loadtxt(path, delimiter=",", skiprows=1)
                ask = Reference(table[:, 0], *np.split(table[:, 1:], 3, axis=1))
                after = class_at(examine(robot, logs + plant.run([ask], rng=rng)), name)
            for rival in sorted({*advice.splits} - {true.id}):
                split = not {true.id, rival} <= after
                right = {"split": split, "right": split and true.id in after}
                pairs.append(row | right | {"rival": rival, "runs": bool(advice.file)})
    return pairs


def main() -> None:
    """Measure all cases, say what came out, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=1)
    seeds, console, pairs = parser.parse_args().seeds, Console(), list[dict[str, Any]]()
    robot = Robot.load(MODEL)
    for seed in range(seeds):
        for effect_id in JOINTS:
            for size in SIZES:
                found = measure(robot, true_effect(robot, effect_id, size), seed)
                pairs += [{"size": size} | pair for pair in found]
            console.print(effect_id, len(pairs))
    console.print(write_report(pairs, f"python experiments/advice.py --seeds {seeds}"))


if __name__ == "__main__":
    main()
