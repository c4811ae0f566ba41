"""Errors of the same stages over many runs: medians, spread, and the way down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from published_chain import PLAIN

from hybrid.arrays import Array
from hybrid.report.style import BLACK, BLUE, GREY, RED, clean, legend, new_figure
from hybrid.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Study:
    """Errors of K stages over S runs that differ in their seed.

    Attributes:
        joints: Joint names, n of them.
        stages: Names of the stages, K of them; those of the published chain begin
            with "published". All are compared with the better of LS and WLS.
        rms: RMS torque error, shape (S, K, n), [N·m].
        relative: RMS error over RMS torque, shape (S, K, n).
        floor: RMS of the noise that no model predicts, shape (S, n), [N·m].
        published: Mean RMS of a publication, by stage, to stand beside, [N·m].
    """

    joints: tuple[str, ...]
    stages: tuple[str, ...]
    rms: Array
    relative: Array
    floor: Array
    published: Mapping[str, float]

    @classmethod
    def of(
        cls, runs: Sequence[Mapping[str, Any]], published: Mapping[str, float]
    ) -> Self:
        """Put runs together; a stage that one left out has the errors before it.

        Args:
            runs: ``joints``, ``noise_floor``, and by stage ``rms`` and ``relative``.
            published: Mean RMS of a publication, by stage, [N·m].
        """
        stages = max((tuple(run["rms"]) for run in runs), key=len)
        floor = np.array([run["noise_floor"] for run in runs])
        both = (
            np.array([_filled(run[key], stages) for run in runs])
            for key in ("rms", "relative")
        )
        return cls(runs[0]["joints"], stages, *both, floor, published)

    @property
    def mean(self) -> Array:
        """Mean RMS over the joints, shape (S, K), [N·m]."""
        return np.asarray(self.rms.mean(axis=2))

    @property
    def cut(self) -> Array:
        """Share of plain least squares' mean RMS that is gone, shape (S, K)."""
        return np.asarray(1.0 - self.mean / self.plain[:, None])

    @property
    def plain(self) -> Array:
        """Mean RMS of the better of LS and WLS, shape (S,), [N·m]."""
        plain = [name in ("LS", "WLS") for name in self.stages]
        return np.asarray(self.mean[:, plain].min(axis=1))

    @property
    def above_floor(self) -> Array:
        """Mean RMS over mean noise, shape (S, K)."""
        return np.asarray(self.mean / self.floor.mean(axis=1)[:, None])

    def table(self) -> Table:
        """Medians over the runs, with the lowest and highest mean."""
        first = next(iter(self.published.values()), 1.0)
        rows = []
        for k, name in enumerate(self.stages):
            row = [name, *_numbers(self.rms[:, k]), *_spread(self.mean[:, k])]
            row += [f"{100 * np.median(self.relative[:, k].mean(axis=1)):.1f} %"]
            row += [
                _percent(np.median(self.cut[:, k])),
                f"{_cut_range(self.cut[:, k])}",
            ]
            row += [f"{np.median(self.above_floor[:, k]):.2f}"]
            if name in self.published:
                theirs = self.published[name]
                row += [f"{theirs:.2f} ({_percent(1 - theirs / first)})"]
            rows.append((*row, *[""] * (len(self.joints) + 8 - len(row))))
        floor = [
            "noise floor",
            *_numbers(self.floor),
            *_spread(self.floor.mean(axis=1)),
        ]
        floor += ["", _percent(np.median(1 - self.floor.mean(1) / self.plain))]
        rows.append((*floor, "", "1.00", ""))
        header = ("", *self.joints, "mean", "lowest–highest", "relative")
        header += ("vs LS", "least–most", "× floor", "published mean")
        caption = f"Held-out RMS torque error, N·m: medians over {len(self.rms)} seeds"
        return Table(header, tuple(rows), caption)

    def figure(self) -> Figure:
        """The mean error after each stage, and per joint what is left against noise."""
        figure = new_figure(height=3.2)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        self._draw_way_down(left)
        self._draw_joints(right)
        legend(figure, left.get_legend_handles_labels()[0], enlarge=1.0)
        return figure

    def _draw_way_down(self, axes: Axes) -> None:
        share = 100 * (1 - self.cut)
        floor = 100 * self.floor.mean(axis=1) / self.plain
        clean(axes, grid="y")
        theirs = np.array([name.startswith("published") for name in self.stages])
        plain = np.array([name in PLAIN for name in self.stages])
        for x, ink, name in (
            (np.flatnonzero(plain | ~theirs), BLUE, "our ladder"),
            (np.flatnonzero(plain | theirs), RED, "published chain"),
        ):
            axes.plot(x, share[:, x].T, color=GREY, linewidth=0.6, alpha=0.5)
            axes.plot(x, np.median(share, axis=0)[x], "o-", color=ink, label=name)
        if self.published:
            values = np.array([*self.published.values()])
            at = [self.stages.index(name) for name in self.published]
            axes.plot(
                at, 100 * values / values[0], "D--", color=BLACK, linewidth=0.8,
                markersize=4, label="the same on another arm, as published",
            )  # fmt: skip
        # A band: every seed has a first stage of its own, and so a floor against it.
        axes.axhspan(floor.min(), floor.max(), color=BLACK, alpha=0.08, linewidth=0)
        axes.axhline(np.median(floor), color=BLACK, linestyle=":", label="noise floor")
        axes.set_ylim(0, 1.05 * share.max())
        axes.set_ylabel("mean RMS error [% of plain LS]", fontsize=8)
        names = [x.removeprefix("published").strip(" ,") for x in self.stages]
        axes.set_xticks(np.arange(len(names)), names, fontsize=7, rotation=20)

    def _draw_joints(self, axes: Axes) -> None:
        x, ratio = np.arange(len(self.joints)), self.rms / self.floor[:, None]
        clean(axes, grid="y")
        theirs = [k for k, x in enumerate(self.stages) if x.startswith("published")]
        inks = (0, GREY, -0.2), (theirs[-1], RED, 0.0), (-1, BLUE, 0.2)
        for k, ink, shift in inks:
            axes.plot(x + shift, ratio[:, k].T, ".", color=ink, markersize=3, alpha=0.5)
            axes.plot(x + shift, np.median(ratio[:, k], axis=0), "o", color=ink)
        axes.axhline(1.0, color=BLACK, linestyle=":")
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("RMS error / noise floor (grey: LS)", fontsize=8)
        axes.set_xticks(x, self.joints, rotation=35, ha="right")


def _filled(rows: Mapping[str, Array], stages: Sequence[str]) -> list[Array]:
    found: list[Array] = []
    for name in stages:
        found.append(rows[name] if name in rows else found[-1])
    return found


def _numbers(values: Array) -> list[str]:
    """Medians over the runs, shape (S, n)."""
    return [f"{x:.3f}" for x in np.median(values, axis=0)]


def _spread(values: Array) -> list[str]:
    """Median, then lowest and highest, of S values."""
    return [f"{np.median(values):.3f}", f"{values.min():.3f}–{values.max():.3f}"]


def _cut_range(cut: Array) -> str:
    if not np.any(cut):
        return ""
    return f"{100 * cut.min():.1f} to {100 * cut.max():.1f} %".replace("-", "−")


def _percent(cut: float) -> str:
    return f"{-100 * cut:+.1f} %".replace("-", "−") if abs(cut) > 5e-4 else "–"
