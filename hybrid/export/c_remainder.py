"""The learned part of a model in C: a function for each kind, tables for each joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hybrid.compensator import GaussianMixtureRegression, NetworkRegression
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.errors import HybridError
from hybrid.export.c_mixture import mixture_function, mixture_tables
from hybrid.export.c_network import network_function, network_tables


def remainder_code(remainder: ArmRemainder, marks: Mapping[str, Any]) -> str:
    """Functions, with room for the largest of each kind, and tables of every joint.

    Raises:
        HybridError: A joint's remainder is of a kind that has no C.
    """
    regressions = [part.regression for part in remainder.parts]
    mixtures = [r for r in regressions if isinstance(r, GaussianMixtureRegression)]
    networks = [r for r in regressions if isinstance(r, NetworkRegression)]
    text = mixture_function(mixtures, marks) if mixtures else ""
    text += network_function(networks, marks) if networks else ""
    for k, regression in enumerate(regressions):
        function_name(regression)
        if isinstance(regression, GaussianMixtureRegression):
            text += "".join(mixture_tables(k, regression, marks))
        elif isinstance(regression, NetworkRegression):
            text += "".join(network_tables(k, regression, marks))
    return text


def function_name(regression: object) -> str:
    """Name, without the arm's, of the function that works a regression out.

    Raises:
        HybridError: It has none.
    """
    if isinstance(regression, GaussianMixtureRegression):
        return "gmr_at"
    if isinstance(regression, NetworkRegression) and regression.history == 1:
        return "network_at"
    kind = getattr(regression, "kind", type(regression).__name__)
    raise HybridError(
        f"a remainder of kind {kind} has no C; valid are gmr and network without a "
        "history, and the format torchscript takes every kind"
    )
