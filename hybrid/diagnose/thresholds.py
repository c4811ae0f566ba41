"""Thresholds of the diagnosis, frozen in a file beside the script that made them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True)
class Thresholds:
    """When to name an effect, and when to abstain.

    Attributes:
        version: Of the file.
        alike: Evidence within which two effects explain a recording alike, [nat].
        alike_share: The same as a share of the evidence for either: no law is exact.
        spurious: Share of a joint's noise that the flexible regression may recover
            without any gap.
        coloured: Share of what is left at a joint that may be in the lower half of the
            band, beyond what is in the upper.
        evident: Least squares that it must recover at a joint, in units of noise.
        negligible: RMS that is not worth a cause, over that of the measured torque.
        complete: Least part of what is explainable at a joint that its terms explain.
        roughly: The same where they are of laws that hold roughly: of play and springs;
            and of exact laws, beside all that is missed there, explainable or not.
        steady: Most that gains of their own on each fold may take from the gap, over
            what the term takes.
        crowded: Most terms at one joint that still make a cause.
        undone: Least that remains of two like effects at one joint together, of the
            squares of each.
        explained: Least part of the whole gap explained for the verdict ``explained``.
    """

    version: str
    alike: float
    alike_share: float
    spurious: float
    coloured: float
    evident: float
    negligible: float
    complete: float
    roughly: float
    steady: float
    crowded: int
    undone: float
    explained: float


@cache
def thresholds() -> Thresholds:
    """The frozen thresholds."""
    path = Path(__file__).with_name("thresholds.json")
    return Thresholds(**json.loads(path.read_text(encoding="utf-8")))
