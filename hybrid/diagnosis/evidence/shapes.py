"""The shapes of an effect: what its torque is not linear in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import Effect
from hybrid.effects.effect import Quantity

_PRICE = 2.0  # of choosing one shape; the logarithm of how many differ in effect
_SCAN_PRICE = 8.0  # of a gain that is scanned: each value is another law
_REACH = 0.2  # of a shape's range, to either side
_WIDE = 8.0  # times the lower bound: such a range is even in its logarithm
_MOST_TRIALS = 40
_ENDLESS = 1e4  # s
_NUDGE = 0.05  # of the reach, for a derivative


def price(effect: Effect) -> float:
    """Evidence that the choice of an effect's shapes has to pay for, [nat]."""
    if effect.choices is not None:
        return effect.choices
    return _PRICE * len(effect.shapes) + (_SCAN_PRICE if effect.steep else 0.0)


@dataclass(frozen=True)
class _Range:
    """A shape's range, as 0 to 1."""

    shape: Quantity

    @property
    def wide(self) -> bool:
        return self.shape.lower > 0 and self.shape.upper > _WIDE * self.shape.lower

    def place(self, value: float) -> float:
        low, high = self.shape.lower, self.shape.upper
        if self.wide:
            return float(np.log(value / low) / np.log(high / low))
        return (value - low) / (high - low)

    def value(self, place: float) -> float:
        low, high, x = self.shape.lower, self.shape.upper, min(max(place, 0.0), 1.0)
        value = low * (high / low) ** x if self.wide else low + x * (high - low)
        return float(np.clip(value, low, high))


def part_of_range(shape: Quantity, low: float, high: float) -> float:
    """How much of a shape's range lies between two of its values, 0 to 1."""
    whole = _Range(shape)
    return whole.place(high) - whole.place(low)


def fit_shapes(
    effect: Effect, gain: Callable[[Effect], float], gap: Gap
) -> tuple[Effect, float]:
    """Maximise a function of an effect over its shapes, near the given ones.

    Args:
        effect: The effect with the shapes to start from.
        gain: What to maximise.
        gap: For the bounds of the shapes.

    Returns:
        The effect with better shapes, and what was gained.
    """
    ranges = _ranges(gap, effect)
    if not ranges:
        return effect, gain(effect)

    def at(x: Array) -> Effect:
        return at_places(gap, effect, x)

    search = _one if len(ranges) == 1 else _several
    start, reach = places(gap, effect), _reach(effect, ranges[0])
    best = at(search(lambda x: -gain(at(x)), start, reach))
    return best, gain(best)


def _reach(effect: Effect, first: _Range) -> float:
    """How far to look, in parts of the range."""
    if first.shape.near is None:
        return _REACH
    value = effect.values[first.shape.name]
    return first.place(value + first.shape.near) - first.place(value)


def _one(loss: Callable[[Array], float], start: Array, reach: float) -> Array:
    found = minimize_scalar(
        lambda x: loss(np.array([x])),
        bounds=(max(0.0, start[0] - reach), min(1.0, start[0] + reach)),
        method="bounded",
        options={"xatol": 5e-3 * reach, "maxiter": 16},
    )
    return np.array([found.x])


def _several(loss: Callable[[Array], float], start: Array, reach: float) -> Array:
    steps = np.where(start + reach / 2 <= 1.0, reach / 2, -reach / 2)
    options = {
        "initial_simplex": np.vstack([start, start + np.diag(steps)]),
        "maxfev": _MOST_TRIALS,
        "xatol": 0.005,
        "fatol": 0.1,
    }
    found = minimize(
        loss,
        start,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * len(start),
        options=options,  # type: ignore[call-overload]
    )
    return np.asarray(found.x)


def nudges(gap: Gap, effect: Effect) -> list[Columns]:
    """Change of an effect's torque with each shape, per whole range of the shape.

    Args:
        gap: Where to evaluate it.
        effect: The effect with its gains.

    Returns:
        For each shape a column at every joint that the effect reaches, shape (M, 1).
    """
    now, gains = gap.columns(effect), effect.gain_values
    blocks: list[Columns] = []
    for r in _ranges(gap, effect):
        place = r.place(effect.values[r.shape.name])
        step = _NUDGE * _reach(effect, r)
        step = step if place + step <= 1.0 else -step
        then = gap.columns(effect.at({r.shape.name: r.value(place + step)}))
        blocks.append({j: ((then[j] - now[j]) @ gains / step)[:, None] for j in now})
    return blocks


def places(gap: Gap, effect: Effect) -> Array:
    """Places of an effect's shapes in their ranges, 0 to 1, shape (s,)."""
    return np.array(
        [r.place(effect.values[r.shape.name]) for r in _ranges(gap, effect)]
    )


def at_places(gap: Gap, effect: Effect, at: Array) -> Effect:
    """An effect with its shapes at places in their ranges, or at the nearest end."""
    values = zip(_ranges(gap, effect), at, strict=True)
    return effect.at({r.shape.name: r.value(float(x)) for r, x in values})


def shape_units(gap: Gap, effect: Effect) -> list[float]:
    """Change of each shape's value with its place in its range, at its value."""
    units = []
    for r in _ranges(gap, effect):
        place = r.place(effect.values[r.shape.name])
        step = _NUDGE * _reach(effect, r)
        low, high = max(place - step, 0.0), min(place + step, 1.0)
        units.append((r.value(high) - r.value(low)) / (high - low))
    return units


def _ranges(gap: Gap, effect: Effect) -> list[_Range]:
    scale = gap.scales[effect.joints[-1]]
    shapes = [s.scaled(scale) for s in effect.shapes if not s.whole]
    return [_Range(_near(s, effect.values[s.name])) for s in shapes]


def _near(shape: Quantity, value: float) -> Quantity:
    """A shape within reach: of a time on a clock without end, what is around it."""
    if shape.upper <= _ENDLESS:
        return shape
    low, high = value - shape.typical, value + shape.typical
    return replace(shape, lower=max(low, shape.lower), upper=min(high, shape.upper))
