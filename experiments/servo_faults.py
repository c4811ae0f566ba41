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
from pathlib import Path

from blind.run import code_digest
from outputs import command_line
from servo_arms import RATES, log, with_servos
from servo_outcomes import outcome, table_of
from servo_spoilt import FAULTS

from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.report import provenance, write_results
from hybrid.robot import Robot
from hybrid.servo import fit_servo
from hybrid.servo.drive import QUANTITIES

LOGS = 3


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
    code = code_digest()
    cases = [x for x in cases if x.get("code") == code]
    for fault, arm in [(f, a) for f in args.faults.split(",") for a in robots]:
        about = {"arm": Path(arm).stem, "fault": fault, "seed": args.seed, "code": code}
        if any(about.items() <= x.items() for x in cases):
            continue  # the same code has answered it
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
        told = {k: x for k, x in fit.as_dict().items() if k != "servos"}
        cases.append(about | {"fit": told})
        asked = f"--seed {args.seed}" + " --withheld" * args.withheld
        how = provenance(command=f"python experiments/servo_faults.py {asked}")
        write_results(stored, {"cases": cases, "provenance": how})
        print(*(about[x] for x in ("arm", "fault", "joint", "said")), flush=True)
    with atomic_path(args.out / f"{name}.md") as path:
        path.write_text(table_of(cases), encoding="utf-8")


if __name__ == "__main__":
    main()
