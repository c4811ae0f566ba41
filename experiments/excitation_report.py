"""Table and figure of the torque error after identification from several designs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid.files import atomic_path
from hybrid.report import (
    Table,
    markdown_table,
    provenance,
    save_figure,
    write_results,
)
from hybrid.report.style import BLUE, GREY, OTHERS, clean, legend, new_figure

INKS = (GREY, OTHERS[0], OTHERS[1], BLUE)


@dataclass(frozen=True)
class Comparison:
    """Errors of D designs over S seeds and P plants; the first design is the measure.

    Attributes:
        joints: Joint names, n of them.
        designs: Names of the designs.
        rms: RMS torque error on another motion, shape (S, P, D, n), [N·m].
        seconds: CPU time of each design, shape (S, D), [s].
        conditions: Condition number of each, shape (S, D).
    """

    joints: tuple[str, ...]
    designs: tuple[str, ...]
    rms: np.ndarray
    seconds: np.ndarray
    conditions: np.ndarray

    @property
    def lower(self) -> np.ndarray:
        """By how much each error is lower than that of the first design, [%]."""
        return 100 * (1 - self.rms / self.rms[:, :, :1])

    @property
    def _gained(self) -> list[int]:
        """Joints whose gain the table shows: of many only the last, their mean."""
        return list(range(len(self.joints)))[-1 if len(self.joints) > 3 else 0 :]

    def table(self, plant: int) -> Table:
        """Medians over the seeds on one plant."""
        rms, lower = self.rms[:, plant], self.lower[:, plant]
        rows = []
        for k, name in enumerate(self.designs):
            errors = [f"{x:.3f}" for x in np.median(rms[:, k], axis=0)]
            gains = [spread(x) if k else "" for x in lower[:, k, self._gained].T]
            figures = (self.conditions[:, k], self.seconds[:, k])
            rows.append(
                (name, *errors, *gains, *(f"{np.median(x):.1f}" for x in figures))
            )
        header = ("", *(f"{x} [N·m]" for x in self.joints))
        header += tuple(f"{self.joints[j]}: lower by [%]" for j in self._gained)
        return Table((*header, "condition", "design [CPU s]"), tuple(rows))

    def write(
        self,
        folder: Path,
        name: str,
        plants: tuple[str, ...],
        lead: str,
        more: str = "",
    ) -> None:
        """Write the table, the figure and JSON, and print the table."""
        seeds = len(self.rms)
        command = f"python experiments/{name}.py --seeds {seeds}"
        parts = [
            f"RMS torque error on another motion: median of {seeds} seeds, and in "
            f"brackets the lowest and the highest; {lead}."
        ]
        for k, plant in enumerate(plants):
            parts += [f"Arm with {plant} friction:", markdown_table(self.table(k))]
        parts += [more] if more else []
        text = "\n\n".join((*parts, f"`{command}`\n"))
        with atomic_path(folder / "table.md") as path:
            path.write_text(text, encoding="utf-8")
        content = {"provenance": provenance(command=command), **vars(self)}
        write_results(folder / "results.json", content | {"plants": plants})
        save_figure(self.figure(plants), folder / "figure.png")
        print(text)

    def figure(self, plants: tuple[str, ...]):
        """Error of every design, joint and plant."""
        cells = [(p, j) for p in range(len(plants)) for j in range(len(self.joints))]
        columns = min(len(self.joints), 4)
        rows = -(-len(cells) // columns)
        figure = new_figure(2.0 * rows + 0.4)
        for k, (p, j) in enumerate(cells):
            axes = figure.add_subplot(rows, columns, k + 1)
            clean(axes, grid="y")
            bars = axes.boxplot(
                self.rms[:, p, :, j], patch_artist=True, widths=0.5,
                medianprops={"color": "black"},
            )  # fmt: skip
            for box, ink, label in zip(
                bars["boxes"], INKS[: len(self.designs)], self.designs, strict=True
            ):
                box.set_facecolor(ink)
                box.set_label(label)
            axes.set_xticks([])
            title = self.joints[j] if columns > 2 else f"{self.joints[j]}, {plants[p]}"
            axes.set_title(title, loc="left", fontsize=9)
            if k % columns == 0:
                axes.set_ylabel("RMS error [N·m]")
        legend(figure, bars["boxes"])
        return figure


def spread(x: np.ndarray) -> str:
    """Median, lowest and highest."""
    return f"{np.median(x):.1f} ({x.min():.1f}…{x.max():.1f})"


def readings_table(readings, plants, rms):
    """How much lower the second design is than the first, in R readings of the logs.

    Args:
        readings: Their names.
        plants: Names of the plants.
        rms: Errors, shape (S, P, R, D, n), [N·m].
    """
    lower = 100 * (1 - rms[..., 1, :] / rms[..., 0, :])  # (S, P, R, n)
    rows = [
        (name, *(spread(x) for x in lower[:, :, r].reshape(len(rms), -1).T))
        for r, name in enumerate(readings)
    ]
    joints = range(1, rms.shape[-1] + 1)
    header = (
        "reading of the logs",
        *(f"{p}: joint {j}" for p in plants for j in joints),
    )
    lead = "Error of the improved series lower than of the plain one, both genetic, by "
    lead += "[%], in other readings of the same logs:"
    return f"{lead}\n\n{markdown_table(Table(header, tuple(rows)))}"
