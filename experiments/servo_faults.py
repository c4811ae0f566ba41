"""One fault of an arm that logs command and position only: is it named?

Arms with position servos and one fault each, or none, are fitted from the file without
the fault; with `--withheld` the fault is no candidate. A table appears: for each arm
and fault, what is said. A fault does not show where the file itself replays all joints
within a step of the encoder; another is equivalent where it replays unseen motion so.

    python experiments/servo_faults.py --so101 FILE --seed 300 --out OUT
"""

from __future__ import annotations

import json
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from outputs import command_line
from servo_arms import FAULTS, RATES, TICK, log, with_servos

from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results
from hybrid.robot import Robot
from hybrid.servo import ServoFit, fit_servo
from hybrid.servo.drive import QUANTITIES

LOGS = 3
# Not told apart by motion at all, or shapes of one law.
ALIKE = {
    "stribeck": {"coulomb"}, "encoder_offset": {"torque_offset"},
    "backlash": {"deadzone"},
}  # fmt: skip


def outcome(fit: ServoFit, fault: str, j: int) -> str:
    """What is said, against what is true."""
    said = {(x.effect, x.joint): {x.effect, *x.equivalents} for x in fit.findings}
    if fault == "none":
        return "right" if not said else f"false: {named(said)}"
    alike, joint = {fault} | ALIKE.get(fault, set()), fit.robot.joints[j]
    here = {x: e for x, e in said.items() if fault == "payload" or x[1] == joint}
    good = {x for x, effects in here.items() if effects & alike}
    others = {x for x in said if x not in good}
    if good:
        right = any(effect == fault for effect, _ in good)
        text = "right" if right else "in class"
        return f"{text}, and {named(others)}" if others else text
    if not (fit.before > TICK).any():
        return f"{named(others)}, does not show" if others else "does not show"
    if fit.after[j] < TICK:
        return f"equivalent: {named(others)}" if others else "nothing"
    unsaid = "abstains" if "no known cause" in fit.sentence else "another"
    return (
        f"{unsaid}: {named(others) or 'nothing'}, {1000 * fit.after[j]:.1f} mrad left"
    )


def named(said) -> str:
    """Effects and joints in words."""
    return ", ".join(f"{effect} at {joint}" for effect, joint in sorted(said))


def table_of(cases: list[dict]) -> str:
    """What was said, faults down and arms across."""
    said: dict[str, dict[str, str]] = {}
    for x in cases:
        said.setdefault(x["fault"], {})[x["arm"]] = f"{x['said']} ({x['joint']})"
    arms = list(dict.fromkeys(x["arm"] for x in cases))
    rows = tuple((f, *(said[f].get(a, "") for a in arms)) for f in said)
    counts = Counter(x["said"].split(":")[0] for x in cases)
    told = ", ".join(f"{v} {k}" for k, v in counts.most_common())
    seconds = np.median([x["seconds"] for x in cases])
    text = markdown_table(Table(("", *arms), rows, words=True))
    return f"{text}\n{told}; {seconds:.0f} s of processor time a case (median)\n"


def main() -> None:
    """Simulate, fit and write."""
    parser = command_line(__doc__, "servo_faults")
    parser.add_argument("--arms", default=",".join(RATES))
    parser.add_argument("--so101", type=Path, help="MJCF file of an SO-101")
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--seed", type=int, default=0, help="of motions and joints")
    parser.add_argument("--withheld", action="store_true")
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    name = "withheld" if args.withheld else "results"
    stored = args.out / f"{name}.json"
    cases = json.loads(stored.read_text())["cases"] if stored.exists() else []
    arms = [x for x in args.arms.split(",") if x != "SO101" or args.so101]
    files = {x: str(args.so101) if x == "SO101" else x for x in arms}
    robots = {x: with_servos(Robot.load(file)) for x, file in files.items()}
    for fault, arm in [(f, a) for f in args.faults.split(",") for a in robots]:
        about = {"arm": Path(arm).stem, "fault": fault, "seed": args.seed}
        if any(about.items() <= x.items() for x in cases):
            continue  # stored answers are kept
        robot, struck = robots[arm], []
        j = (FAULTS.index(fault) + args.seed) % robot.size
        seeds = range(args.seed, args.seed + LOGS)
        logs = [log(robot, fault, j, seed, RATES[arm]) for seed in seeds]
        if args.withheld:
            own = [k for k, x in enumerate(QUANTITIES) if x.effect == fault]
            struck = [(k, i) for k in own for i in range(robot.size)]
        start = time.process_time()
        fit = fit_servo(robot, logs, without=struck)
        about |= {"joint": robot.joints[j], "said": outcome(fit, fault, j)}
        about["seconds"] = time.process_time() - start
        cases.append(about | {"fit": fit.as_dict()})
        how = provenance(
            command=f"python experiments/servo_faults.py --seed {args.seed}"
        )
        write_results(stored, {"cases": cases, "provenance": how})
        print(*about.values(), flush=True)
    with atomic_path(args.out / f"{name}.md") as path:
        path.write_text(table_of(cases), encoding="utf-8")


if __name__ == "__main__":
    main()
