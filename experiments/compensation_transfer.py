"""Effects first, learning last: does a model then carry over to loads and speeds?

A table and a figure appear: held-out RMS torque error of the simulated COMAN-like arm
when the same mixture regression learns (a) all that a rigid body leaves, (b) what plain
friction leaves, (c) what all stages and diagnosed effects leave; on motions like those
learned from, with a payload of known mass, and at higher speed; and the RMS torque that
was learned. Medians and spread over seeds.

    python experiments/compensation_transfer.py --seeds 3
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from compensation import kinds_of_motion, load_arm
from compensation_learned import learned
from compensation_models import diagnosed_effects
from measures import measures_figure, measures_table
from outputs import captioned, command_line, write_tables
from rich.console import Console

from hybrid import identify, simulate, validate
from hybrid.errors import HybridWarning
from hybrid.report import save_figure, terminal_table
from hybrid.signals import motion_from_recording

MEASURES = dict.fromkeys(("seen before", "payload", "faster", "learned"), "N·m")


def measure(seed: int, kept: Path) -> dict[str, Any]:
    """Errors of all three on the three kinds of motions."""
    robot, plant = load_arm()
    logs = simulate(plant, trajectories=4, fill=0.6, duration=8.0, seed=seed)
    kinds, payload = kinds_of_motion(plant, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        stages = ("rigid", "friction", "ripple")
        named = diagnosed_effects(robot, plant, kept)
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
    parser = command_line(__doc__, "compensation_transfer")
    parser.add_argument("--seeds", type=int, default=3)
    args, console, runs = parser.parse_args(), Console(width=220), []
    command = f"python experiments/compensation_transfer.py --seeds {args.seeds}"
    for seed in range(args.seeds):
        runs.append(measure(seed, args.out / "diagnosed.json"))
        console.print({k: np.round(runs[-1][k], 3).tolist() for k in MEASURES})
    values = {name: np.array([run[name] for run in runs]) for name in MEASURES}
    table = measures_table(runs[0]["models"], values, MEASURES)
    save_figure(
        measures_figure(runs[0]["models"], values, MEASURES), args.out / "figure.png"
    )
    write_tables(args.out, captioned(table), command, runs=runs)
    console.print(terminal_table(table))


if __name__ == "__main__":
    main()
