"""A design on disk: references as CSV, coefficients and figures of merit as JSON."""

from __future__ import annotations

import csv
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.files import atomic_folder, atomic_path, write_json
from hybrid.plant.reference import Reference

if TYPE_CHECKING:
    from hybrid.excitation.design import Design

DESIGN = "design.json"


def reference_paths(folder: Path, count: int) -> list[Path]:
    """Files of the references of a design: ``reference_1.csv`` and so on."""
    return [folder / f"reference_{k + 1}.csv" for k in range(count)]


def write_reference(
    path: str | Path, reference: Reference, joints: tuple[str, ...]
) -> None:
    """Write a motion to run: time [s], then q [rad], v [rad/s] and a [rad/s²].

    Args:
        path: CSV file; columns are ``t``, ``q_<joint>``, ``v_<joint>``, ``a_<joint>``.
        reference: Motion of n joints.
        joints: Joint names, length n.
    """
    header = ["t", *(f"{x}_{name}" for x in "qva" for name in joints)]
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        rows = zip(reference.t, reference.q, reference.v, reference.a, strict=True)
        for t, *states in rows:
            writer.writerow([f"{x:.10g}" for x in (t, *(y for s in states for y in s))])


def write_design(
    folder: str | PathLike[str],
    design: Design,
    *,
    rate: float,
    more: dict[str, Any] | None = None,
) -> list[Path]:
    """Write the references and ``design.json``.

    Args:
        folder: Where the files shall be.
        design: Motions.
        rate: Samples of the references per second, [Hz].
        more: JSON-ready content to add, such as how it came about.

    Returns:
        The files of the references.
    """
    folder = Path(folder)
    paths = reference_paths(folder, len(design.trajectories))
    with atomic_folder(folder) as hidden:
        for path, trajectory in zip(paths, design.trajectories, strict=True):
            reference = trajectory.reference(rate)
            write_reference(hidden / path.name, reference, design.robot.joints)
        write_json(hidden / DESIGN, design.as_dict() | (more or {}))
    return paths
