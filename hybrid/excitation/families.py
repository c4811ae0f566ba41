"""Families of motions by name, to read saved coefficients back."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.errors import ExcitationError
from hybrid.excitation.fourier import Fourier, FourierQuintic, PlainFourier
from hybrid.excitation.path import Family, Trajectory
from hybrid.excitation.spline import Spline

_FAMILIES: dict[str, type[Any]] = {
    "fourier": Fourier,
    "fourier_quintic": FourierQuintic,
    "plain_fourier": PlainFourier,
    "spline": Spline,
}


def family_from_dict(content: dict[str, Any]) -> Family:
    """The family that :meth:`Family.as_dict` described.

    Raises:
        ExcitationError: There is no such family, or an option is not valid.
    """
    options = dict(content)
    name = options.pop("name", None)
    if name not in _FAMILIES:
        raise ExcitationError(
            f"no family {name!r}; valid are {', '.join(sorted(_FAMILIES))}"
        )
    try:
        family: Family = _FAMILIES[name](**options)
    except TypeError as error:
        raise ExcitationError(f"family {name!r}: {error}") from error
    return family


def trajectory_from_dict(content: dict[str, Any]) -> Trajectory:
    """The motion that :meth:`Trajectory.as_dict` described, equal to the last bit.

    Raises:
        ExcitationError: It is no such description.
    """
    try:
        family = family_from_dict(content["family"])
        return Trajectory(family, np.array(content["coefficients"], dtype=float))
    except (KeyError, TypeError, ValueError) as error:
        raise ExcitationError(f"not a saved motion: {error}") from error
