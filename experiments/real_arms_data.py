"""The real arms of ``real_arms.py``, how their logs are split, and a split's score."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid import Fit, Motion
from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.identification import DynamicModel, Validation, ValidationRow


@dataclass(frozen=True)
class Arm:
    """One arm's logs and how they are split.

    Attributes:
        name: Its type.
        folder: Where its robot file and logs are.
        cutoff: Cut-off of columns and torque, [Hz].
        standing: Speed above which a sample is scored, [rad/s].
        block: Length of the blocks, every third of which is held out, [s]; 0 fits on
            the first log and scores on the second.
        effects: Terms beyond the usual ones.
    """

    name: str
    folder: str
    cutoff: float
    standing: float
    block: float
    effects: tuple[Effect, ...] = ()

    def splits(self, motions: list[Motion]) -> Iterator[tuple[str, Motion, Motion]]:
        """What is held out, in words, and the motions to fit and to score on."""
        if not self.block:
            yield Path(motions[1].source).stem, motions[0], motions[1]
            return
        (motion,) = motions
        block = ((motion.t - motion.t[0]) // self.block).astype(int)
        for phase in range(3):
            out = block % 3 == phase
            fitting = replace(motion, mask=motion.mask & ~out)
            scoring = replace(motion, mask=motion.mask & out)
            yield f"blocks {phase}, {phase + 3}, …", fitting, scoring


ARMS = (
    Arm("UR10", "ur10_salerno", 10, 0.02, 1.0),
    Arm("TX40", "tx40_figaroh", 50, 0.05, 0.5,
        (TransmissionCoupling((4, 5)),)),
    Arm("KR300", "kr300_kaiserslautern", 8, 0.02, 0.0),
)  # fmt: skip


@dataclass(frozen=True)
class Score:
    """One split of one arm: what was fitted, and its errors on what was held out.

    Attributes:
        arm: The arm.
        held_out: What was held out, in words.
        fit: The identification.
        validation: Errors of all stages.
        squares: Squares of LS or WLS, the better at each joint by what the fit itself
            held out, and of the last stage, in each second, shape (2, B, n), [N²·m²].
        warnings: What the identification said.
    """

    arm: Arm
    held_out: str
    fit: Fit
    validation: Validation
    squares: Array
    warnings: tuple[str, ...]

    @property
    def ratio(self) -> Array:
        """RMS of the last stage over that of the better of LS and WLS, shape (n,)."""
        return ratios(self.squares)[0]

    @property
    def ratio_error(self) -> Array:
        """Standard error of the ratio by leaving out single seconds, shape (n,)."""
        return ratios(self.squares)[1]

    @property
    def plain(self) -> ValidationRow:
        """The better of least squares and weighted least squares, in the mean."""
        plain = [x for x in self.validation.rows if x.name in ("LS", "WLS")]
        return min(plain, key=lambda row: row.mean)

    def said(self) -> str:
        """What the identification says of itself."""
        unknowns, few = len(self.fit.names), len(self.fit.unidentifiable)
        found = f"condition {self.fit.condition:.0f}, {few} of {unknowns} unknowns open"
        found = (
            f"{self.arm.name}, {self.held_out} held out: {found} or not told from zero"
        )
        return "; ".join((found, *self.warnings))

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        sources = [Path(path).name for path in self.validation.sources]
        return {
            "arm": self.arm.name,
            "held_out": self.held_out,
            "validation": self.validation.as_dict() | {"sources": sources},
            "ratio": self.ratio,
            "ratio_error": self.ratio_error,
            "condition": self.fit.condition,
            "unidentifiable": self.fit.unidentifiable,
            "warnings": self.warnings,
        }


def ratios(squares: Array) -> tuple[Array, Array]:
    """RMS of ours over plain least squares, with its standard error, shape (n,) each.

    Args:
        squares: See :class:`Score`; the error is found by leaving out single seconds.
    """

    def ratio(sums: Array) -> Array:
        return np.asarray(np.sqrt(sums[1] / sums[0]))

    few = squares.sum(axis=1, keepdims=True) - squares
    error = np.sqrt(squares.shape[1] - 1) * ratio(few).std(axis=0)
    return ratio(squares.sum(axis=1)), error


def held_out_squares(fit: Fit, motion: Motion, standing: Array) -> Array:
    """Squares of plain least squares and of a fit, by second; see :class:`Score`.

    Args:
        fit: The identification.
        motion: The motion to score on.
        standing: Speed below which a joint stands, shape (n,), [rad/s].
    """
    moving = (np.abs(motion.v) > standing) & motion.mask[:, None]
    second = (motion.t - motion.t[0]).astype(int)

    def squares(model: DynamicModel) -> Array:
        residual = np.where(moving, motion.tau - model.predict(motion), 0.0)
        found = np.stack([np.bincount(second, x) for x in residual.T**2], axis=1)
        return found[np.unique(second[motion.mask])]

    simpler, errors = fit.model.simpler, fit.held_out
    plain = np.where(
        errors["LS"] < errors["WLS"], squares(simpler["LS"]), squares(simpler["WLS"])
    )
    return np.stack([plain, squares(fit.model)])
