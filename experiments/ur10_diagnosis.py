"""A diagnosis of a real arm: what does its page say first?

A UR10 moved for twelve seconds; its simulator is its ROS description, which has
no friction. What appears is the verdict; with Chromium, the first screen of the page
goes to the folder of ``--out``. The README shows the one of ``--out docs/images``.

    python experiments/ur10_diagnosis.py
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from coman import ROOT
from diagnosis_example import photograph
from outputs import command_line

from hybrid.cli import main as hybrid

SCREEN = (1000, 1020)  # pixels
MODELS = ROOT / "models"


def main() -> None:
    """Diagnose and photograph."""
    out: Path = command_line(__doc__, "ur10_diagnosis").parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        folder = Path(scratch) / "diagnosis"
        logs = f"--recordings={MODELS / 'ur10_bag'}"
        hybrid(["diagnose", f"--robot={MODELS / 'ur10.urdf'}", logs, f"--out={folder}"])
        photograph(folder / "report.html", out / "ur10_diagnosis.png", SCREEN)


if __name__ == "__main__":
    main()
