"""What a fixed simulator is worth: gains tuned in it, used on the plant.

A table appears. A controller at 100 Hz tracks motions of the planar arm; its gains are
tuned (Nelder-Mead) in the nominal simulator, in one with plain least squares, in the
exported one, and on the plant itself. What counts is the tracking error on the plant,
along the motions of the task and along others, over that of gains tuned on the plant.
It answers what a policy loses that was trained in each simulator: Tan et al. 2018,
doi 10.15607/RSS.2018.XIV.010.

    python experiments/gain_transfer.py --seeds 10
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from excitation_plants import drawn
from gain_transfer_task import STEP, error, of_file, of_plant
from outputs import command_line
from scipy.optimize import minimize

from hybrid import Robot, identify, simulate
from hybrid.export import model_simulator
from hybrid.files import atomic_path
from hybrid.plant import random_fourier
from hybrid.report import Table, markdown_table, provenance, write_results

ARM = Path(__file__).parents[1] / "models" / "planar.xml"
START = np.log([200.0, 80.0, 20.0, 8.0])


def transfer(seed: int) -> dict[str, list[float]]:
    """Error on the plant of gains tuned in each simulator, on both motions, [mrad]."""
    rng, nominal = np.random.default_rng(seed), Robot.load(ARM)
    plant = replace(drawn(nominal, rng)[1], step=STEP, servo=None)
    logs = simulate(plant, trajectories=4, duration=8.0, seed=seed)
    ours = identify(nominal, logs, consistent=True).model
    plain = identify(
        nominal, logs, estimator="ls", stages=("rigid",), consistent=True
    ).model
    where = {"nominal": of_file(ARM.read_text())}
    for name, model in (("plain LS", plain), ("ours", ours)):
        where[name] = of_file(model_simulator(model).text.decode())
    where["plant"] = of_plant(plant)
    task, others = ([random_fourier(nominal, duration=2.0, rate=100.0, rng=rng)
                     for _ in range(2)] for _ in range(2))  # fmt: skip
    found, most = {}, nominal.tau_max
    simplex = START + np.vstack([np.zeros(4), 0.7 * np.eye(4)])
    options = {"maxfev": 100, "fatol": 1e-5, "initial_simplex": simplex}
    for name, start in where.items():
        best = minimize(lambda x, s=start: error(s, x, task, most), START,
                        method="Nelder-Mead", options=options)  # fmt: skip
        found[name] = [
            1e3 * error(where["plant"], best.x, each, most) for each in (task, others)
        ]
    return found


def main() -> None:
    """Run all seeds, print the table, write the report."""
    parser = command_line(__doc__, "gain_transfer")
    parser.add_argument("--seeds", type=int, default=10)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    runs: list[dict[str, list[float]]] = []
    for seed in range(args.seeds):
        runs.append(transfer(seed))
        write(args.out, runs)


def write(out: Path, runs: list[dict[str, list[float]]]) -> None:
    """Print the table of the seeds so far, and write the report."""
    names = list(runs[0])
    off = np.array([[run[name] for name in names] for run in runs])  # (seeds, names, 2)
    ratio = off / off[:, -1:]
    rows = [
        (name, *(f"{x:.3f}" for r in ratio[:, k].T for x in (np.median(r), r.max())))
        for k, name in enumerate(names)
    ]
    header = ("tuned in", "task, median", "worst", "other motions, median", "worst")
    print(text := markdown_table(Table(header, tuple(rows))), flush=True)
    command = f"python experiments/gain_transfer.py --seeds {len(runs)}"
    with atomic_path(out / "table.md") as path:
        path.write_text(f"{text}\n    {command}\n", encoding="utf-8")
    content = {"provenance": provenance(command=command), "runs": runs}
    write_results(out / "results.json", content)


if __name__ == "__main__":
    main()
