"""A diagnosis to look at: what does the report of a known gap say?

A COMAN-like arm has torque ripple at two joints and Stribeck friction at a third that
its simulator has not, and links 2 % off. What appears is the verdict; the page, a table
of truth and findings and, with Chromium, pictures go to the folder of ``--out``.

    python experiments/diagnosis_example.py
"""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from coman import ROOT
from outputs import command_line
from PIL import Image, ImageChops

from hybrid import Robot, simulate
from hybrid.cli import main as hybrid
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.plant import Plant
from hybrid.recording import write
from hybrid.report import Table, markdown_table

ARM = ROOT / "models" / "coman_like.xml"
TRUE = (
    TorqueRipple((0,), {"sine": 2.2, "cosine": 1.0, "periods": 12.0}),
    TorqueRipple((1,), {"sine": 1.6, "cosine": -1.5, "periods": 20.0}),
    Stribeck((2,), {"level": 3.0, "velocity": 0.08}),
)
SIZES = {"desk": (1200, 5200), "phone": (390, 7000)}  # pixels, more than is needed


def record(folder: Path) -> None:
    """Four motions of 10 s of the real arm."""
    robot = Robot.load(ARM)
    off = np.random.default_rng(0).normal(1.0, 0.02, size=(robot.size, 1))
    chain = replace(robot.chain, inertial=robot.chain.inertial * off)
    plant = Plant(replace(robot, chain=chain), TRUE, nominal=robot)
    for k, recording in enumerate(simulate(plant, trajectories=4, seed=0), start=1):
        write(recording, folder / f"trajectory_{k}.parquet")


def table(findings: list[dict]) -> Table:
    """What was found beside the truth."""
    joints = Robot.load(ARM).joints
    true = {(joints[e.joints[0]], x): y for e in TRUE for x, y in e.values.items()}
    rows = []
    for f in findings:
        for v in f["parameters"]:
            place = v["joint"], v["name"]
            numbers = true.get(place, np.nan), v["value"], *v["interval"]
            cells = (f"{number:.4g}" for number in numbers)
            rows.append((place[0], f["effect"], place[1], *cells, v["unit"]))
    header = "joint effect parameter true found low high unit"
    return Table(tuple(header.split()), tuple(rows))


def photograph(page: Path, target: Path, size: tuple[int, int]) -> None:
    """A picture of a page in a window of some pixels, cut below; needs Chromium."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        return
    with TemporaryDirectory() as scratch:
        shot = Path(scratch) / "shot.png"
        flags = f"--headless --no-sandbox --hide-scrollbars --screenshot={shot}"
        flags += f" --window-size={size[0]},{size[1]} --user-data-dir={scratch}/profile"
        flags += f" --virtual-time-budget=4000 {page.resolve().as_uri()}"
        subprocess.run([browser, *flags.split()], check=True, stderr=-3)
        image = Image.open(shot).convert("RGB")
    bottom = min(ImageChops.invert(image).getbbox()[3] + 40, size[1])
    few = image.crop((0, 0, size[0], bottom)).quantize(200, Image.Quantize.MAXCOVERAGE)
    few.save(target, optimize=True)


def main() -> None:
    """Simulate, diagnose, compare with the truth, and photograph."""
    out: Path = command_line(__doc__, "diagnosis_example").parse_args().out
    with TemporaryDirectory() as scratch:
        record(Path(scratch))
        args = f"--robot={ARM}", f"--recordings={scratch}", f"--out={out}"
        hybrid(["diagnose", *args])
    found = json.loads((out / "diagnosis.json").read_text("utf-8"))["findings"]
    (out / "table.md").write_text(markdown_table(table(found)), "utf-8")
    for name, size in SIZES.items():
        photograph(out / "report.html", out / f"{name}.png", size)


if __name__ == "__main__":
    main()
