"""Data of the page of a diagnosis: curves of each joint, and a matrix of evidence.

Curves have few points, all of held-out samples.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.report.style import extremes

MOST_POINTS = 1500  # of a curve or a scatter plot
_DIGITS = 4
_LEAST_SHARE = 0.05  # of the squares that a finding explains at its main joint
_LEAST_EVIDENCE = 3.0  # nat: a row with less is only named
_DECADE = float(np.log(10.0))
_DARKEST = 60.0  # per cent: black text on it is legible


def joint_curves(result: Result, i: int) -> dict[str, Any]:
    """The gap of a joint over time, and over position, speed, acceleration and load.

    Returns:
        JSON-ready: ``name``, ``noise`` and its ``unit``; ``time``, abscissa and
        gap, without and with the findings; ``marks``, where recordings begin; ``over``,
        values of position, speed, acceleration and load; ``clouds``, for each finding
        that acts here the residual without it and its fitted law, at those values.
    """
    gap, scored, m = result.gap, result.scored, result.gap.sampled
    order = np.argsort(scored.evidence.rows[i])
    rows = scored.evidence.rows[i][order]
    t, marks = continuous_time(
        m.t, gap.trajectory, rows, [x.source for x in gap.motions]
    )
    spots = np.arange(0, len(rows), max(1, -(-len(rows) // MOST_POINTS)))
    at, unit = rows[spots], partial(gap.robot.chain.unit_at, [i])
    over = {
        "position": (m.q[at, i], unit("rad")),
        "speed": (m.v[at, i], unit("rad/s")),
        "acceleration": (m.a[at, i], unit("rad/s²")),
        "load": (gap.load[at, i], unit("N·m")),
    }
    return {
        "name": gap.robot.joints[i],
        "unit": unit("N·m"),
        "noise": result.diagnosis.noise_floor[i],
        "time": thin(t, [gap.left[rows, i], scored.after[i][order]], rows),
        "marks": marks,
        "over": {name: {"x": _short(x), "unit": u} for name, (x, u) in over.items()},
        "clouds": _clouds(
            scored, i, order[spots], {k: x for k, (x, _) in over.items()}
        ),
    }


def thin(
    x: Array, curves: Sequence[Array], rows: Index, most: int = MOST_POINTS
) -> list[list[float | None]]:
    """Reduce curves to their ends and the lowest and highest point of each interval.

    ``None`` breaks the lines where samples are missing.

    Args:
        x: Abscissa, shape (N,).
        curves: Ordinates, each of shape (N,).
        rows: Index of each sample in the gap, shape (N,).
        most: Largest number of points of a curve.

    Returns:
        The abscissa and each ordinate, at the same points.
    """
    kept = extremes(curves, most)
    stretch = np.cumsum(np.diff(rows, prepend=rows[:1]) > 1)[kept]
    xs, *ys = (_short(values[kept]) for values in (x, *curves))
    for at in np.flatnonzero(np.diff(stretch))[::-1] + 1:
        xs.insert(at, xs[at])
        for y in ys:
            y.insert(at, None)
    return [xs, *ys]


def continuous_time(
    t: Array, trajectory: Index, rows: Index, sources: Sequence[str]
) -> tuple[Array, list[dict[str, Any]]]:
    """Time with recordings one after another, and the start of each, [s]."""
    out, start, marks = np.zeros(len(rows)), 0.0, []
    of = trajectory[rows]
    for k in np.unique(of):
        whole = t[trajectory == k]
        out[of == k] = t[rows[of == k]] - whole[0] + start
        name = Path(sources[k]).name or f"recording {k + 1}"
        marks.append({"x": _short(out[of == k][:1])[0], "name": name})
        start += whole[-1] - whole[0]
    return out, marks


def _clouds(
    scored: Explanation, i: int, spots: Index, over: Mapping[str, Array]
) -> list[dict[str, Any]]:
    def cloud(effect: str, law: Array, shown: Array) -> dict[str, Any]:
        order = sorted(over, key=lambda name: _roughness(over[name], shown))
        y = _short(after + law)
        return {"effect": effect, "y": y, "law": _short(law), "order": order}

    found, after = [], scored.after[i][spots]
    for effect in dict.fromkeys(term.place[0] for term in scored.terms):
        own = [k for k, term in enumerate(scored.terms) if term.place[0] == effect]
        parts = [scored.contribution(k) for k in own]
        laws = [np.sum(x, axis=0) for x in zip(*parts, strict=True)]  # at each joint
        squares = [x @ x / n for x, n in zip(laws, scored.evidence.noise, strict=True)]
        if squares[i] > _LEAST_SHARE * max(squares):
            found.append(cloud(effect, laws[i][spots], laws[i][spots]))
    return found or [cloud("", np.zeros(len(after)), after)]


def _roughness(x: Array, y: Array) -> float:
    """Distance of y from a function of x: 0 if it is one, about 1 if unrelated.

    Source: von Neumann 1941, doi 10.1214/aoms/1177731677 (mean square of successive
    differences over variance).
    """
    variance = np.var(y) if len(y) > 1 else 0.0  # a joint at rest has no sample
    if variance == 0:
        return 1.0
    step = np.diff(y[np.argsort(x, kind="stable")])
    return float(np.mean(step**2) / (2 * variance))


def _short(x: Array) -> list[float | None]:
    """Numbers with four digits, as a page shows."""
    return [float(f"{value:.{_DIGITS}g}") for value in x]


@dataclass(frozen=True)
class Cell:
    """Evidence of one effect at one joint, or at all, as decimal logarithm of odds.

    In addition to the findings (``beside``), it is for a finding the evidence that its
    removal loses.
    """

    width: int  # number of joints that the cell covers
    joints: str
    alone: float
    beside: float
    named: bool  # whether it is a finding


@dataclass(frozen=True)
class Matrix:
    """Rows of cells by effect, strongest first, and the effects without evidence."""

    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    silent: tuple[str, ...]

    def shade(self, evidence: float) -> float:
        """Darkness of a cell in per cent, on a logarithmic scale."""
        cells = [cell for _, row in self.rows for cell in row]
        top = max(max(cell.alone, cell.beside) for cell in cells)
        return float(_DARKEST * np.log1p(evidence) / np.log1p(top)) if top else 0.0


def evidence_matrix(result: Result) -> Matrix:
    """Collect the evidence of every effect at every joint."""
    search, joints = result.search, result.gap.robot.joints
    found = defaultdict[tuple[str, tuple[int, ...]], float](float)
    for t in search.terms:  # several ripples may share a place
        found[t.place] = max(found[t.place], search.loss(t))
    alone = {c.place: gain for c, gain in search.ranked(search.background)}
    beside = {c.place: gain for c, gain in search.ranked(search.base())} | found
    scopes = {t.place: t.candidate.effect for t in (*search.pool.tried, *search.terms)}
    cells: dict[str, dict[int, Cell]] = {}
    for place, effect in scopes.items():
        whole = effect.scope == "arm"
        column, width = (0, len(joints)) if whole else (effect.at_joints[0], 1)
        cell = Cell(
            width,
            " + ".join(joints[column : column + width]),
            max(0.0, alone.get(place, 0.0)) / _DECADE,
            max(0.0, beside.get(place, 0.0)) / _DECADE,
            place in found,
        )
        row = cells.setdefault(place[0], {})
        row[column] = max(row.get(column, cell), cell, key=_rank)
    for effect in result.delays:  # removed before the search
        (j,) = effect.joints
        cells.setdefault(effect.id, {})[j] = _delay_cell(result, j)
    order = sorted(cells, key=lambda e: max(map(_rank, cells[e].values())))[::-1]
    least = _LEAST_EVIDENCE / _DECADE
    shown = [
        e
        for e in order
        if any(c.named or max(c.alone, c.beside) > least for c in cells[e].values())
    ]
    rows = tuple((e, _filled(cells[e], len(joints))) for e in shown)
    return Matrix(rows, silent=tuple(sorted({*order} - {*shown})))


def _delay_cell(result: Result, j: int) -> Cell:
    """Evidence at one joint of a delay that all joints share."""
    scored = result.scored.learnt or result.scored
    rows, noise = scored.evidence.rows[j], scored.evidence.noise[j]
    change = (result.gap.left - result.search.gap.left)[rows, j]
    alone, beside = (
        max(0.0, float(np.sum((left + change) ** 2 - left**2) / noise / 2)) / _DECADE
        for left in (scored.before[j], scored.after[j])
    )
    return Cell(1, result.gap.robot.joints[j], alone, beside, named=True)


def _rank(cell: Cell) -> tuple[bool, float]:
    return cell.named, cell.alone


def _filled(row: dict[int, Cell], size: int) -> tuple[Cell, ...]:
    """The cells of a row, with empty ones where there is none."""
    if 0 in row and row[0].width == size:
        return (row[0],)
    return tuple(row.get(k, Cell(1, "", 0.0, 0.0, False)) for k in range(size))
