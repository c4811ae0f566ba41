"""What of an effect a simulator's joint has a field for, and what is left of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hybrid.effects import Effect
from hybrid.robot.chain import Array


def split_effects(
    effects: Sequence[Effect], fields: Collection[str], size: int
) -> tuple[dict[str, Array], list[Effect]]:
    """Take out of effects what a simulator's joints have fields for.

    Args:
        effects: Effects of an arm.
        fields: The fields that the simulator has, of ``hybrid.effects.instant.FIELDS``.
        size: Number of joints n of the arm.

    Returns:
        Each field's values, shape (n,), and the effects with what is left of them.
    """
    values, rest = {name: np.zeros(size) for name in fields}, []
    for effect in effects:
        gains: dict[str, list[str]] = {}
        for gain, field in effect.fields.items():
            sprung = field == "preload" and "stiffness" in gains
            if field in values and (effect.values[gain] > 0 or sprung):
                gains.setdefault(field, []).append(gain)
        left = dict(effect.values)
        for field, names in gains.items():
            # Several gains for one field are those of several directions.
            if len(names) == sum(f == field for f in effect.fields.values()):
                share = min(left[name] for name in names)
                values[field][effect.joints[0]] += share
                left |= {name: left[name] - share for name in names}
        if any(left[g.name] for g in effect.gains):
            rest.append(effect if left == effect.values else effect.at(left))
    return values, rest
