"""What do two workers of a fleet cost beside one, on weeks of logs of a real arm?

Arms whose weeks are copies of the packaged log of a UR10. A table of the cost of a unit
appears, with the efficiency at two workers, and a plan for ten thousand such arms. What
a unit costs the process that hands out is small beside it: where others use the
machine, it takes more arms to see it.

    python experiments/fleet_efficiency.py --logs 5
"""

from __future__ import annotations

import shutil
import tempfile
from datetime import timedelta
from pathlib import Path

from fleet_costs import Costs, costs
from fleet_plant import FIRST_DAY
from outputs import command_line
from rich.console import Console

from hybrid.fleets.plan import plan_from_dict
from hybrid.report import markdown_table

MODELS = Path(__file__).parents[1] / "models"
LOG = MODELS / "ur10_bag" / "ur10_bag.mcap"


def main() -> None:
    """Copy logs, measure, print and write the table."""
    parser = command_line(__doc__, "fleet_efficiency")
    parser.add_argument("--arms", type=int, default=9)
    parser.add_argument("--weeks", type=int, default=3)
    parser.add_argument("--logs", type=int, default=5, help="in a week")
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for arm in range(args.arms):
            own = Path(folder) / f"arm_{arm}"
            own.mkdir()
            for week in range(args.weeks):
                for log in range(args.logs):
                    day = FIRST_DAY + timedelta(7 * week + log)
                    shutil.copy(LOG, own / f"{day}.mcap")
        plan = plan_from_dict({"robot": str(MODELS / "ur10.urdf"), "arms": folder})
        bytes_read = args.logs * LOG.stat().st_size
        tables = costs(Costs.measured(plan, 1, args.arms, args.runs), bytes_read)
    command = (
        f"python experiments/fleet_efficiency.py --arms {args.arms} "
        f"--weeks {args.weeks} --logs {args.logs} --runs {args.runs}"
    )
    text = "\n".join(f"{x.caption}\n\n{markdown_table(x)}" for x in tables)
    text = f"# Cost of a fleet of UR10s\n\n    {command}\n\n{text}"
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "report.md").write_text(text, encoding="utf-8")
    Console(width=120).print(text, highlight=False)


if __name__ == "__main__":
    main()
