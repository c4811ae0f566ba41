"""Improved Stribeck friction by annealed genetic search and separable least squares.

Tables appear: the recovered parameters of joints 1-3 of a six-axis arm beside the true
(published) ones, the squares that the law removes beside the published shares, for
three sizes of what no law explains (the publication does not state its own), how far
solvers agree, their time and generations, and all six joints at once, moving together,
with the rigid body unknown. A figure shows the way down.

    python experiments/improved_stribeck.py --seeds 5
"""

from __future__ import annotations

from typing import Any

import numpy as np
from friction_solvers import GENERATIONS, LAWS, SEARCHES, full, searched, separable
from improved_stribeck_report import write_report
from joint_friction_logs import RATE, RIPPLE, TRUE, improved, one_joint
from joint_friction_together import all_joints_at_once
from outputs import command_line

from hybrid.arrays import Array

_T = np.arange(0, 25, 1 / RATE)
_W = 0.1 * np.pi * np.arange(0, 20, 1 / RATE)
SLOW = np.pi / 4 + 0.2 * (np.cos(0.08 * np.pi * _T) - 1)
FAST = np.pi / 4 + 0.8 * (np.cos(0.2 * np.pi * _T[: round(10 * RATE)]) - 1)
CHECK = (
    0.3 * np.cos(_W) + 0.6 * np.sin(_W) + 0.1 * np.cos(2 * _W) - 0.05 * np.sin(2 * _W)
)
RIPPLES = (0.25, 0.5)  # of f_C: more torque that no law knows
# In the order f_C, f_S, v_s, f_V, f_P, v_0: published for joint 1, widened for 2 and 3.
BOUNDS = np.array(
    [[[5, 15, 0.001, 10, -1, 0], [20, 50, 0.1, 40, 1, 0.1]]]
    + 2 * [[[5, 15, 0.001, 10, -8, 0], [80, 150, 0.1, 160, 8, 0.1]]]
)


def fitted(joint: int, ripple: float) -> tuple[Array, Array, dict[str, Any]]:
    """Speed and friction torque of one joint, and every law fitted to them."""
    rng = np.random.default_rng(joint)
    v, y = one_joint(joint, [SLOW, FAST], rng, ripple)
    v_check, y_check = one_joint(joint, [CHECK], rng, ripple)
    fits = {name: separable(v, y, law, BOUNDS[joint]) for name, law in LAWS.items()}
    for name, fit in fits.items():
        left = y_check - improved(v_check, full(LAWS[name], fit["x"]))
        fit["check_squares"] = float(left @ left)
    return v, y, fits


def study(joint: int, seeds: int) -> dict[str, Any]:
    """Every law and solver on one joint."""
    v, y, fits = fitted(joint, RIPPLE)
    laws = ("Stribeck", "improved") if joint == 0 else ("improved",)
    found = {x: searched(v, y, LAWS[x], BOUNDS[joint], seeds) for x in laws}
    for law, solvers in found.items():
        for name in SEARCHES:
            for run in solvers[name]:
                near = run["history"] < 1.01 * fits[law]["squares"]
                run["generations"] = int(near.argmax()) + 1 if near.any() else None
    rippled = {f"{x:.0%}": fitted(joint, x)[2] for x in RIPPLES}
    return {"true": TRUE[joint], "samples": len(y), "searches": found} | {
        "fits": fits,
        "fits by ripple": {f"{RIPPLE:.0%}": fits} | rippled,
    }


def main() -> None:
    """Study the joints, print and write the tables."""
    parser = command_line(__doc__, "improved_stribeck")
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    seeds: int = args.seeds
    joints = [study(joint, seeds) for joint in range(3)]
    together = all_joints_at_once(np.random.default_rng(7))
    write_report(args.out, joints, together, GENERATIONS, f"--seeds {seeds}")


if __name__ == "__main__":
    main()
