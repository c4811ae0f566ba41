"""Two plants with one kind of effect each: is it named, and is the gap removed?

The six-axis arm of ``models/`` follows a random Fourier motion of 10 s with PD position
servos, logged at 500 Hz with usual noise. One plant has torque ripple on joints 1 and 2
(counted from 0), the other Stribeck friction on joints 0 to 2, of random size; links,
rotors and declared friction are exactly those of the simulator. The diagnosis gets one
log. A third plant lacks nothing; all are run with a tenth of the torque noise, too.
What appears: effects and joints named, the torque gap on a second motion before and
after, also above the floor that the plant's own effects leave, and processor time.
Where the extra ``mujoco[sysid]`` is installed, its fit of 19 parameters to the same log
stands beside.

    python experiments/diagnosis_acceptance.py --seeds 5
"""

from __future__ import annotations

from diagnosis_acceptance_case import JOINTS, run
from diagnosis_acceptance_report import summary, table
from outputs import captioned, command_line, write_tables
from rich.console import Console

from hybrid.report import terminal_table


def main() -> None:
    """Run both plants for all seeds, print the table, write the report."""
    parser = command_line(__doc__, "diagnosis_acceptance")
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    seeds = args.seeds
    cases = [(k, quiet) for quiet in (False, True) for k in JOINTS]
    runs = [run(k, s, quiet) for k, quiet in cases for s in range(seeds)]
    shown, text = table(runs), "\n".join(f"- {line}" for line in summary(runs))
    Console(width=140).print(terminal_table(shown), text, highlight=False)
    command = f"python experiments/diagnosis_acceptance.py --seeds {seeds}"
    text = f"{captioned(shown)}\n{text}\n"
    write_tables(args.out, text, command, runs=[x.as_dict() for x in runs])


if __name__ == "__main__":
    main()
