"""The learned part of a model in C: a function, and tables for each joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.errors import HybridError
from hybrid.exports.c_mixture import mixture_function, mixture_tables


def remainder_code(remainder: ArmRemainder, marks: Mapping[str, Any]) -> str:
    """The function, with room for the largest mixture, and tables of every joint.

    Raises:
        HybridError: A joint's remainder is of a kind that has no C.
    """
    mixtures = []
    for part in remainder.parts:
        function_name(part.regression)
        if isinstance(part.regression, GaussianMixtureRegression):
            mixtures.append(part.regression)
    text = mixture_function(mixtures, marks) if mixtures else ""
    for k, mixture in enumerate(mixtures):
        text += "".join(mixture_tables(k, mixture, marks))
    return text


def function_name(regression: object) -> str:
    """Name, without the arm's, of the function that works a regression out.

    Raises:
        HybridError: It has none.
    """
    if isinstance(regression, GaussianMixtureRegression):
        return "gmr_at"
    kind = getattr(regression, "kind", type(regression).__name__)
    raise HybridError(
        f"a remainder of kind {kind} has no C; valid is gmr, and the format "
        "torchscript takes every kind"
    )
