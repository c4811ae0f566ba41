"""Effects first, learning last: does a model then carry over to loads and speeds?

A table and a figure appear: held-out RMS torque error of the simulated COMAN-like arm
when the same mixture regression learns (a) all that a rigid body leaves, (b) what plain
friction leaves, (c) what all stages and diagnosed effects leave; on motions like those
learned from, with a payload of known mass, and at higher speed; and the RMS torque that
was learned. Medians and spread over seeds.

    python experiments/compensation_transfer.py --seeds 3
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from coman import ROOT
from compensation import kinds_of_motion, load_arm
from compensation_learned import learned
from compensation_models import diagnosed_effects
from rich.console import Console

from hybrid import identify, simulate, validate
from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.report import markdown_table, numbers_table, provenance, save_figure
from hybrid.report import write_results as write
from hybrid.report.measures import measures_figure, measures_table
from hybrid.signals import motion_from_recording

REPORT = ROOT / "reports" / "compensation_transfer"
MEASURES = dict.fromkeys(("seen before", "payload", "faster", "learned"), "N·m")


def measure(seed: int) -> dict[str, Any]:
    """Errors of all three on the three kinds of motions."""
    robot, plant = load_arm()
    logs = simulate(plant, trajectories=4, fill=0.6, duration=8.0, seed=seed)
    kinds, payload = kinds_of_motion(plant, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        stages = ("rigid", "friction", "ripple")
        named = diagnosed_effects(robot, plant)
        full = identify(robot, logs, stages=stages, effects=named).model
        plain = identify(robot, logs, stages=stages[:1]).model.simpler["LS"]
    rotors = tuple(e for e in plain.effects if e.id == "armature")
    rigid = replace(plain, effects=rotors)
    models = {"all but rigid": rigid, "all but LS": plain, "effects first": full}
    found: dict[str, Any] = {"seed": seed, "models": list(models)}
    found |= {name: [] for name in MEASURES}
    for model in models.values():
        whole = learned(model, logs)
        for name, motions in kinds.items():
            known = replace(whole, simpler={})
            if name == "payload":
                known = replace(known, effects=(*known.effects, payload))
            found[name].append(validate(known, motions).rows[-1].mean)
        motion = motion_from_recording(kinds["seen before"][0], cutoff=whole.cutoff)
        part = whole.remainder.predict(motion.q, motion.v)  # type: ignore[union-attr]
        found["learned"].append(np.sqrt(np.mean(part**2, axis=0)).mean())
    return found


def main() -> None:
    """Measure all seeds, print the table, write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    count, console, runs = parser.parse_args().seeds, Console(width=220), []
    command = f"python experiments/compensation_transfer.py --seeds {count}"
    for seed in range(count):
        runs.append(measure(seed))
        console.print({k: np.round(runs[-1][k], 3).tolist() for k in MEASURES})
    values = {name: np.array([run[name] for run in runs]) for name in MEASURES}
    table = measures_table(runs[0]["models"], values, MEASURES)
    save_figure(
        measures_figure(runs[0]["models"], values, MEASURES), REPORT / "figure.png"
    )
    write(
        REPORT / "results.json",
        {"provenance": provenance(command=command), "runs": runs},
    )
    with atomic_path(REPORT / "table.md") as path:
        text = f"{table.caption}.\n\n{markdown_table(table)}\n    {command}\n"
        path.write_text(text)
    console.print(numbers_table(table))


if __name__ == "__main__":
    main()
