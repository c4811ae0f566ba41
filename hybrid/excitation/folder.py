"""Files of a design: references as CSV, results as JSON."""

import csv
from pathlib import Path

from hybrid.files import atomic_path
from hybrid.plant.reference import Reference

DESIGN = "design.json"


def reference_paths(folder: Path, count: int) -> list[Path]:
    """Files of the references of a design: ``reference_1.csv`` and so on."""
    return [folder / f"reference_{k + 1}.csv" for k in range(count)]


def write_reference(
    path: str | Path, reference: Reference, joints: tuple[str, ...]
) -> None:
    """Write a reference: time [s], then q [rad], v [rad/s] and a [rad/s²].

    Columns are ``t``, ``q_<joint>``, ``v_<joint>``, ``a_<joint>``.
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
