"""A diagnosis to look at: what does the report of a known gap say?

A COMAN-like arm has torque ripple at its first two joints and Stribeck friction at its
elbow; every link parameter of its simulator is off by 2 % besides. What appears is the
verdict. ``reports/diagnosis_example/`` receives the page (report.html), its content
(diagnosis.json), what was found beside the truth (table.md), and, where a Chromium is
installed, pictures of the page on a desk and on a phone.

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
from PIL import Image, ImageChops

from hybrid import Robot, simulate
from hybrid.cli import main as hybrid
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.plant import Plant
from hybrid.recording import write
from hybrid.report import Table, markdown_table

ARM, REPORT = ROOT / "models" / "coman_like.xml", ROOT / "reports" / "diagnosis_example"
TRUE = (
    TorqueRipple((0,), {"sine": 2.2, "cosine": 1.0, "periods": 12.0}),
    TorqueRipple((1,), {"sine": 1.6, "cosine": -1.5, "periods": 20.0}),
    Stribeck((2,), {"level": 3.0, "velocity": 0.08}),
)
SIZES = {"desk": (1200, 5200), "phone": (390, 7000)}  # pixels, more than is needed
OFF = 0.02


def record(folder: Path) -> None:
    """Four motions of 10 s of the real arm."""
    robot = Robot.load(ARM)
    off = 1.0 + OFF * np.random.default_rng(0).normal(size=(robot.size, 1))
    chain = replace(robot.chain, inertial=robot.chain.inertial * off)
    plant = Plant(replace(robot, chain=chain), TRUE, nominal=robot)
    for k, recording in enumerate(simulate(plant, trajectories=4, seed=0), start=1):
        write(recording, folder / f"trajectory_{k}.parquet")


def table(findings: list[dict]) -> Table:
    """What was found beside the truth."""
    values = {(v["joint"], v["name"]): v for f in findings for v in f["parameters"]}
    rows = []
    for effect in TRUE:
        joint = Robot.load(ARM).joints[effect.joints[0]]
        for x in (*effect.gains, *effect.shapes):
            v = values.get((joint, x.name), {"value": np.nan, "interval": (0, 0)})
            ends = [f"{end:.4g}" for end in v["interval"]]
            interval = " to ".join(ends) if ends[0] != ends[1] else "searched for"
            numbers = (f"{effect.values[x.name]:.4g}", f"{v['value']:.4g}", interval)
            rows.append((joint, effect.id, x.name, *numbers, x.unit))
    header = ("joint", "effect", "parameter", "true", "found", "95% interval", "unit")
    return Table(header, tuple(rows))


def photograph(browser: str, name: str, scratch: Path) -> None:
    """A picture of the whole page, without the empty space below it, in few colours."""
    shot, (width, height) = scratch / "shot.png", SIZES[name]
    flags = f"--headless --no-sandbox --hide-scrollbars --window-size={width},{height}"
    extra = [f"--screenshot={shot}", f"--user-data-dir={scratch}/profile"]
    page = (REPORT / "report.html").as_uri()
    subprocess.run([browser, *flags.split(), *extra, page], check=True, stderr=-3)
    image = Image.open(shot).convert("RGB")
    box = ImageChops.difference(image, Image.new("RGB", image.size, "white")).getbbox()
    few = image.crop((0, 0, width, min(box[3] + 40, height))).quantize(48)
    few.save(REPORT / f"{name}.png", optimize=True)


def main() -> None:
    """Simulate, diagnose, compare with the truth, and photograph."""
    with TemporaryDirectory() as scratch:
        record(Path(scratch))
        logs = ["--recordings", f"{scratch}/*.parquet"]
        hybrid(["diagnose", "--robot", str(ARM), *logs, "--out", str(REPORT)])
        content = json.loads((REPORT / "diagnosis.json").read_text("utf-8"))
        text = markdown_table(table(content["findings"]))
        command = "    python experiments/diagnosis_example.py"
        (REPORT / "table.md").write_text(f"{text}\n{command}\n", "utf-8")
        browser = shutil.which("chromium") or shutil.which("google-chrome")
        for name in SIZES if browser else ():
            photograph(browser, name, Path(scratch))


if __name__ == "__main__":
    main()
