"""The evidence for every effect at every joint, as a matrix."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hybrid.diagnosis.answer.result import Result
    from hybrid.effects import Effect

_LITTLE = 3.0  # nats: a row with less is only named
_DECADE = float(np.log(10.0))
_DARKEST = 60.0  # per cent: black text is legible on it


@dataclass(frozen=True)
class Cell:
    """One effect at one joint.

    Attributes:
        width: Number of joints that the cell stands for.
        joints: Their names.
        alone: Evidence for it when nothing else is added, factors of ten of the odds.
        beside: Evidence for it beside the findings; for a finding what its removal
            would lose.
        named: Whether it is a finding.
    """

    width: int
    joints: str
    alone: float
    beside: float
    named: bool


@dataclass(frozen=True)
class Matrix:
    """Rows of cells, strongest first, and the effects without evidence."""

    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    silent: tuple[str, ...]

    def shade(self, evidence: float) -> float:
        """Darkness of a cell in per cent, by the logarithm: evidence spans decades."""
        cells = [cell for _, row in self.rows for cell in row]
        top = max(max(cell.alone, cell.beside) for cell in cells)
        return float(_DARKEST * np.log1p(evidence) / np.log1p(top)) if top else 0.0


def evidence_matrix(result: Result) -> Matrix:
    """Collect the evidence for every effect at every joint.

    Args:
        result: A diagnosis with the search that found its terms.
    """
    search, joints = result.search, result.gap.robot.joints
    found: dict[tuple[str, tuple[int, ...]], float] = {}
    for t in search.terms:  # several ripples may share a place
        found[t.place] = max(found.get(t.place, 0.0), search.loss(t))
    alone = {c.place: gain for c, gain in search.ranked(search.background)}
    beside = {c.place: gain for c, gain in search.ranked(search.base())} | found
    scopes = {t.place: t.candidate.effect for t in (*search.pool.tried, *search.terms)}
    cells: dict[str, dict[int, Cell]] = {}
    for place, effect in scopes.items():
        column, width = _columns(effect, len(joints))
        cell = Cell(
            width,
            " + ".join(joints[column : column + width]),
            max(0.0, alone.get(place, 0.0)) / _DECADE,
            max(0.0, beside.get(place, 0.0)) / _DECADE,
            place in found,
        )
        row = cells.setdefault(place[0], {})
        if column not in row or (cell.named, cell.alone) > _rank(row[column]):
            row[column] = cell
    for effect in result.late:  # taken back before the search
        (j,) = effect.joints
        cells.setdefault(effect.id, {})[j] = _late(result, j)
    order = sorted(cells, key=lambda e: max(map(_rank, cells[e].values())))[::-1]
    loud = [e for e in order if any(map(_speaks, cells[e].values()))]
    rows = tuple((e, tuple(_filled(cells[e], len(joints)))) for e in loud)
    silent = tuple(sorted(e for e in order if e not in loud))
    return Matrix(rows, silent)


def _late(result: Result, j: int) -> Cell:
    """What speaks for torque that is late at every joint, at one of them."""
    scored = result.scored.learnt or result.scored
    rows, noise = scored.evidence.rows[j], scored.evidence.noise[j]
    change = (result.gap.left - result.search.gap.left)[rows, j]
    alone, beside = (
        max(0.0, float(np.sum((left + change) ** 2 - left**2) / noise / 2)) / _DECADE
        for left in (scored.before[j], scored.after[j])
    )
    return Cell(1, result.gap.robot.joints[j], alone, beside, named=True)


def _columns(effect: Effect, size: int) -> tuple[int, int]:
    """First joint and number of joints of an effect's cell."""
    if effect.scope == "arm":
        return 0, size
    return (effect.joints[-1] if effect.id == "link_inertia" else effect.joints[0]), 1


def _rank(cell: Cell) -> tuple[bool, float]:
    return cell.named, cell.alone


def _speaks(cell: Cell) -> bool:
    return cell.named or max(cell.alone, cell.beside) > _LITTLE / _DECADE


def _filled(row: dict[int, Cell], size: int) -> Iterator[Cell]:
    column = 0
    while column < size:
        cell = row.get(column, Cell(1, "", 0.0, 0.0, False))
        yield cell
        column += cell.width
