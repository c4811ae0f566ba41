"""What the site takes from outside its folder: the gallery of effects, and reports."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from mkdocs.structure.files import File, Files

from hybrid import Motion, Robot
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect, effect_classes
from hybrid.names import markdown
from hybrid.plant.scale import joint_scales
from hybrid.report.output import figure_bytes
from hybrid.report.style import BLUE, clean, new_figure

ROOT = Path(__file__).parents[2]
_ON = {"joint": "one joint", "coupling": "several joints", "arm": "the whole arm"}


def on_files(files: Files, config: Any) -> Files:
    """Add the gallery, the pages at the root, and every report that a page links."""
    wanted = {"CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "models/README.md"}
    for page in sorted((ROOT / "docs").rglob("*.md")):
        links = re.findall(r"\]\((?:\.\./)+(reports/[^)#]+)\)", page.read_text("utf-8"))
        wanted.update(links)
    for path in sorted(wanted):
        add(files, config, path, (ROOT / path).read_bytes())
    pages = ["# Gallery of effects\n", "Each effect is one file. This page comes from "
             "these files.\nThe curve is the torque of the effect at its usual size on "
             "the planar example arm, over the\nspeed of its elbow.\n"]  # fmt: skip
    for cls in effect_classes().values():
        picture = f"images/effects/{cls.id}.svg"
        drawn = draw(cls)
        if drawn is not None:
            add(files, config, picture, drawn)
        pages.append(section(cls, picture if drawn is not None else ""))
    add(files, config, "effects.md", "\n".join(pages).encode())
    return files


def on_page_markdown(text: str, page: Any, **more: Any) -> str:
    """Links that leave ``docs/`` lead to the copies in the site."""
    path = page.file.src_uri
    up = "../" * path.count("/")
    text = re.sub(r"\]\((?:\.\./)+(reports/|models/)", rf"]({up}\1", text)
    if path.startswith("reports/"):  # figures and data beside a report stay there
        text = re.sub(r"!?\[([^\]]*)\]\((?!http)[^)]*\)", r"\1", text)
    return text


def add(files: Files, config: Any, path: str, content: bytes) -> None:
    """Add a file to the site."""
    if files.get_file_from_path(path) is None:
        files.append(File.generated(config, path, content=content))


def section(cls: type[Effect], picture: str) -> str:
    """What an effect says of itself."""
    sentence = cls.sentence.replace("{joints}", "the joint")
    rows = "\n".join(
        f"| {x.name} | {x.unit or '–'} | {x.typical:g} | {x.lower:g} to {x.upper:g} |"
        for x in (*cls.gains, *cls.shapes)
    )
    image = f"![Torque of {cls.id}]({picture})\n\n" if picture else ""
    return (
        f"## {cls.id.replace('_', ' ')}\n\n{markdown(sentence)}\n\n"
        f"    {cls.equation}\n\n{image}"
        "| parameter | unit | usual | plausible |\n|---|---|---|---|\n"
        f"{rows}\n\n**Remedy.** {markdown(cls.remedy)}\n\n"
        f"**Acts on** {_ON[cls.scope]}, at the port `{cls.port.value}`. "
        f"**Source.** {markdown(cls.source)}\n"
    )


def draw(cls: type[Effect]) -> bytes | None:
    """Torque of an effect over the variable of which it is most nearly a function.

    None where no single torque stands for the effect.
    """
    robot = Robot.load("planar")
    t = np.linspace(0.0, 4.0, 2001)
    second = 0.9 * np.sin(3 * t + 0.5) + 0.2 * np.sin(7 * t)
    waves = np.stack([0.9 * np.sin(2 * t), second], axis=1)
    v = np.gradient(waves, t, axis=0)
    zero = np.zeros_like(v)
    warm = np.linspace(10.0, 60.0, len(t))[:, None] + zero  # °C, of a drive at work
    motion = Motion(
        t, waves, v, np.gradient(v, t, axis=0), zero, np.ones(len(t), bool),
        temperature=warm, joints=robot.joints,
    )  # fmt: skip
    body = RigidBody(robot.chain, motion)
    joints = (1,) if cls.scope == "joint" else (0, 1)
    effect = cls.typical(joints, joint_scales(robot))
    torque = effect.columns(motion, body)[:, -1] @ effect.gain_values
    if not np.any(torque):  # it changes commands, or large torques only
        return None
    figure = new_figure(height=2.2)
    axes = figure.subplots()
    inner = slice(100, -100)
    variables = {
        "speed [rad/s]": v, "position [rad]": waves, "acceleration [rad/s²]": motion.a,
    }  # fmt: skip
    along = {label: x[inner, 1] for label, x in variables.items()}
    torque = torque[inner]
    label = min(
        along, key=lambda x: np.abs(np.diff(torque[np.argsort(along[x])])).sum()
    )
    axes.plot(along[label], torque, color=BLUE, linewidth=1.2)
    clean(axes, grid="both")
    axes.set_xlabel(label)
    axes.set_ylabel("torque [N·m]")
    return figure_bytes(figure)
