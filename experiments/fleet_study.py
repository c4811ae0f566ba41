"""Does the fleet find worn, swapped, wrongly loaded arms in a season, and nothing else?

A simulated line of arms, week by week, with planted faults of three sizes. Tables of
detections by kind and size, and of false alarms, appear, with temperatures and without
them, and for arms that are watched alone; and what a unit costs.

    python experiments/fleet_study.py --healthy 64 --each 4 --weeks 26
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

from fleet_costs import Costs, costs
from fleet_plant import Arm, line, record
from fleet_scores import by_kind, false_alarms, outcomes
from outputs import command_line
from rich.console import Console

from hybrid.files import write_json
from hybrid.fleets.fleet import Fleet, fleet, fleet_from_rows
from hybrid.fleets.plan import Plan, plan_from_dict
from hybrid.report import Table, markdown_table
from hybrid.robot import Robot

ARM = Path("models/scara.xml")
TOOL = [0.2, 0.0, -0.12]


def variants(plan: Plan, found: Fleet) -> dict[str, Fleet]:
    """The same rows as they are, without temperatures, and every arm alone."""
    cold = [{**row, "temperature": float("nan")} for row in found.rows]
    alone = tuple(replace(arm, group=arm.name) for arm in plan.arms)
    single = replace(plan, arms=alone)
    return {
        "together": found,
        "together, no temperature": fleet_from_rows(plan, cold),
        "alone": fleet_from_rows(single, found.rows),
        "alone, no temperature": fleet_from_rows(single, cold),
    }


def simulated(
    arms: list[Arm], weeks: int, folder: Path, seed: int, workers: int
) -> None:
    """Write the logs that are not there yet."""
    todo = [arm for arm in arms if not (folder / f"{arm.name}.json").exists()]
    robot, folders = Robot.load(ARM), [folder / arm.name for arm in todo]
    with ProcessPoolExecutor(workers) as pool:
        jobs = repeat(robot), todo, repeat(weeks), folders, repeat(seed)
        for _ in pool.map(record, *jobs):
            pass


def main() -> None:
    """Simulate, run, score, and write the report."""
    parser = command_line(__doc__, "fleet")
    parser.add_argument("--healthy", type=int, default=64)
    parser.add_argument("--each", type=int, default=4)
    parser.add_argument("--weeks", type=int, default=26)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--logs", type=Path, default=Path("out/fleet_logs"))
    parser.add_argument("--workers", type=int, default=2)
    args, console = parser.parse_args(), Console(width=200)
    arms = list(line(args.healthy, args.each, args.weeks, args.seed))
    simulated(arms, args.weeks, args.logs, args.seed, args.workers)
    plan = plan_from_dict(
        {"robot": str(ARM.resolve()), "tool": TOOL, "arms": str(args.logs.resolve())}
    )
    found = fleet(plan, args.logs.parent / "fleet_results", workers=args.workers)
    joints = Robot.load(ARM).joints
    tables, runs = list[Table](), dict[str, list[dict[str, Any]]]()
    for name, each in variants(plan, found).items():
        runs[name] = outcomes(each, arms, joints)
        tables += [by_kind(runs[name], name), false_alarms(each, arms, name)]
    sizes = [x.stat().st_size for x in args.logs.rglob("*.parquet")]
    tables += costs(Costs.measured(plan, 2, 8, 3), sum(sizes) / len(sizes))
    args.out.mkdir(parents=True, exist_ok=True)
    command = (
        f"python experiments/fleet_study.py --healthy {args.healthy} "
        f"--each {args.each} --weeks {args.weeks} --seed {args.seed}"
    )
    text = "\n".join(f"{x.caption}\n\n{markdown_table(x)}" for x in tables)
    text = f"# Fleet\n\n    {command}\n\n{text}"
    (args.out / "report.md").write_text(text, encoding="utf-8")
    write_json(args.out / "outcomes.json", runs)
    console.print(text, highlight=False)


if __name__ == "__main__":
    main()
