"""Two plants with one kind of effect each: is it named, and is the gap removed?

The six-axis arm of ``models/`` follows a random Fourier motion of 10 s with PD position
servos, logged at 500 Hz with usual noise. One plant has torque ripple on joints 1 and 2
(counted from 0), the other Stribeck friction on joints 0 to 2, of random size; links,
rotors and declared friction are exactly those of the simulator. The diagnosis gets one
log. What appears: effects and joints named, the torque gap on a second motion before
and after, also less the gap that the plant's own effects leave, and processor time.
Where the extra ``mujoco[sysid]`` is installed, its fit of 19 parameters to the same log
stands beside.

    python experiments/diagnosis_acceptance.py --seeds 5
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

import numpy as np
from diagnosis_acceptance_report import Run, summary, table
from diagnosis_acceptance_sysid import fit_by_sysid, has_sysid
from rich.console import Console

from hybrid import Robot, simulate
from hybrid.diagnose.diagnose import examine, replayed
from hybrid.diagnose.fixed import fixed_model, fixed_simulator
from hybrid.diagnose.gap import Gap, measure_gap
from hybrid.effects import Effect
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.files import atomic_path
from hybrid.identify import DynamicModel
from hybrid.plant import Plant
from hybrid.report import markdown_table, numbers_table, provenance, write_results

ROOT = Path(__file__).parents[1]
ARM, REPORT = ROOT / "models" / "coman_like.xml", ROOT / "reports"
REPORT /= "diagnosis_acceptance"


def truth(kind: str, robot: Robot, rng: np.random.Generator) -> list[Effect]:
    """Effects of a plant; sizes are shares of rated torque."""
    effects: list[Effect] = []
    for j in (1, 2) if kind == "torque_ripple" else (0, 1, 2):
        size = robot.tau_max[j] * rng.uniform(0.02, 0.04)
        if kind == "torque_ripple":
            turn, periods = rng.uniform(0, 2 * np.pi), float(rng.integers(8, 30))
            wave = {"sine": size * np.sin(turn), "cosine": size * np.cos(turn)}
            effects.append(TorqueRipple((j,), {**wave, "periods": periods}))
        else:
            speed = rng.uniform(0.04, 0.12)
            effects.append(Stribeck((j,), {"level": size, "velocity": speed}))
    return effects


def left(gap: Gap, model: DynamicModel, joints: list[int]) -> float:
    """RMS that a model leaves of a motion's torque at some joints, [N·m]."""
    ((motion, _, sampler),) = gap
    off = gap.sampled.tau + gap.left - sampler(model.predict(motion))
    return float(np.sqrt(np.mean(off[:, joints][gap.moving[:, joints]] ** 2)))


def run(kind: str, seed: int) -> Run:
    """One plant: diagnose its first motion, score on its second."""
    robot = Robot.load(ARM)
    effects = truth(kind, robot, np.random.default_rng([seed, len(kind)]))
    plant = Plant(robot, effects)
    plant = Plant(robot, effects, servo=plant.servo.without_feedforward())
    log, other = simulate(plant, trajectories=2, duration=10.0, seed=seed)
    start = process_time()
    result = examine(robot, [log])
    middle = process_time()
    result = replayed(result, np.random.default_rng(seed))
    seconds = middle - start, process_time() - middle
    gap, joints = (
        measure_gap(robot, [other], cutoff=result.gap.cutoff),
        [e.joints[0] for e in effects],
    )
    models = {
        "before": fixed_model(result.gap, robot, ()),
        "after": fixed_model(result.gap, *fixed_simulator(result)),
        "floor": fixed_model(result.gap, robot, effects),
    }
    fitted = fit_by_sysid(ARM, plant, log) if has_sysid() else None
    if fitted is not None:
        models["sysid"] = fixed_model(result.gap, fitted.robot, ())
    rms = {name: left(gap, model, joints) for name, model in models.items()}
    return Run(kind, seed, tuple(effects), result.diagnosis, rms, seconds, fitted)


def main() -> None:
    """Run both plants for all seeds, print the table, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=5)
    seeds = parser.parse_args().seeds
    runs = [run(k, s) for k in ("torque_ripple", "stribeck") for s in range(seeds)]
    shown, text = table(runs), "\n".join(f"- {line}" for line in summary(runs))
    Console(width=140).print(numbers_table(shown), text, highlight=False)
    command = f"python experiments/diagnosis_acceptance.py --seeds {seeds}"
    with atomic_path(REPORT / "table.md") as path:
        path.write_text(
            f"{shown.caption}.\n\n{markdown_table(shown)}\n{text}\n\n    {command}\n"
        )
    content = {"provenance": provenance(command=command)}
    write_results(
        REPORT / "results.json", content | {"runs": [x.as_dict() for x in runs]}
    )


if __name__ == "__main__":
    main()
