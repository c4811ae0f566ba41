"""From designed motions to a validated model of a six-axis arm, in about a minute.

What appears: progress, then torque errors on motions that no fit has seen, joint by
joint: after each stage of the published chain (least squares, friction by a velocity
threshold, mixture of what is left, iterated), then after each rung of our ladder,
beside the noise that no model can predict. The arm holds hoses and uneven grease, which
no effect of the library describes. The folder that
``--out`` names receives a page to read (index.html), its figures, the numbers
(results.json), and the model itself (model.json).

    make demo
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from demo_report import write_identification
from designed_coman import compare, designed_run
from outputs import command_line
from rich.console import Console

from hybrid.report import provenance, table_from_validation, terminal_table

SEED = 0
console = Console(highlight=False)


@contextmanager
def step(text: str) -> Iterator[None]:
    """Say what is being done while it is, and then how long it took."""
    start = time.perf_counter()
    if not console.is_terminal:
        console.print(f"{text} ...")
    with console.status(f"{text} ..."):
        yield
    console.print(f"  {text}: {time.perf_counter() - start:.0f} s", style="dim")


def main() -> None:
    """Simulate, identify, validate, show, and write the report."""
    out: Path = command_line(__doc__, "demo").parse_args().out
    with step("1/3 designing six motions, simulating them and six others in MuJoCo"):
        run = designed_run(SEED)
    with step("2/3 identifying from the six, validating on the others (30-90 s)"):
        fit, chain, validation = compare(run)
    with step("3/3 drawing figures, writing the report"):
        made = provenance(command="make demo", seed=SEED)
        lead = write_identification(out, fit, validation, run.scoring, provenance=made)
    console.print()
    # A pipe has no width; the table needs one.
    wide = Console(width=max(console.width, 100), highlight=False)
    wide.print(terminal_table(table_from_validation(validation)))
    counts = ", ".join(map(str, chain.components))
    console.print(f"Mixtures of the published chain: {counts} components by BIC.")
    for text in fit.left_out:
        console.print(f"Left out, as it does not help: {text}.")
    console.print(lead)
    console.print(f"Page, figures, numbers and model: {out}/")


if __name__ == "__main__":
    main()
