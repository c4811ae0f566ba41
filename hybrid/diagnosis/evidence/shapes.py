"""The shapes of an effect: the parameters in which its torque is nonlinear.

A shape is searched in normalised form, 0 to 1 over its range.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import FASTEST, Effect, Quantity

_PRICE = 2.0  # nat, logarithm of the number of values of a fitted shape that differ
_SCAN_PRICE = 8.0  # nat, the same of a gain that is scanned
_REACH = 0.2  # of a shape's range, to either side
_WIDE = 8.0  # upper over lower bound, from which on a range is logarithmic
_MOST_TRIALS = 40
_ENDLESS = 1e4  # s, upper bound of a time on a clock
_STEP = 0.05  # of the reach, of a finite difference


def price(effect: Effect) -> float:
    """Odds against the choice of an effect's shapes, [nat]."""
    if effect.choices is not None:
        return effect.choices
    fitted = sum(not x.whole for x in effect.shapes)
    chosen = [x for x in effect.shapes if x.whole and x.name != FASTEST.name]
    price = _PRICE * fitted + (_SCAN_PRICE if effect.steep else 0.0)
    return price + sum(float(np.log(x.upper - x.lower + 1.0)) for x in chosen)


@dataclass(frozen=True)
class Range:
    """A shape's range as 0 to 1; logarithmic where it is wide.

    Attributes:
        shape: The shape.
    """

    shape: Quantity

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm of a value is linear in its normalised form."""
        return self.shape.lower > 0 and self.shape.upper > _WIDE * self.shape.lower

    def normalised(self, value: float) -> float:
        """Normalised form of a value."""
        low, high = self.shape.lower, self.shape.upper
        if self.logarithmic:
            return float(np.log(value / low) / np.log(high / low))
        return (value - low) / (high - low)

    def value(self, normalised: float) -> float:
        """Value of a normalised form, or of the nearest end of the range."""
        low, high = self.shape.lower, self.shape.upper
        x = min(max(normalised, 0.0), 1.0)
        value = low * (high / low) ** x if self.logarithmic else low + x * (high - low)
        return float(np.clip(value, low, high))


def part_of_range(shape: Quantity, low: float, high: float) -> float:
    """Part of a shape's range between two of its values, 0 to 1."""
    whole = Range(shape)
    return whole.normalised(high) - whole.normalised(low)


def fit_shapes(
    effect: Effect, gain: Callable[[Effect], float], gap: Gap
) -> tuple[Effect, float]:
    """Maximise a function of an effect over its shapes, near its own.

    Returns:
        The effect with the best shapes, and the function's value.
    """
    ranges = _ranges(gap, effect)
    if not ranges:
        return effect, gain(effect)

    def at(x: Array) -> Effect:
        return with_normalised_shapes(gap, effect, x)

    search = _one if len(ranges) == 1 else _several
    start, reach = normalised_shapes(gap, effect), _reach(effect, ranges[0])
    best = at(search(lambda x: -gain(at(x)), start, reach))
    return best, gain(best)


def _reach(effect: Effect, first: Range) -> float:
    """Half width of the search in normalised form."""
    if first.shape.near is None:
        return _REACH
    value = effect.values[first.shape.name]
    return first.normalised(value + first.shape.near) - first.normalised(value)


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


def shape_derivatives(gap: Gap, effect: Effect) -> list[Columns]:
    """Derivative of an effect's torque to each normalised shape, shape (M, 1)."""
    now, gains = gap.columns(effect), effect.gain_values
    blocks: list[Columns] = []
    ranges = _ranges(gap, effect)
    for r, x in zip(ranges, normalised_shapes(gap, effect), strict=True):
        step = _STEP * _reach(effect, r)
        step = step if x + step <= 1.0 else -step
        then = gap.columns(effect.at({r.shape.name: r.value(x + step)}))
        blocks.append({j: ((then[j] - now[j]) @ gains / step)[:, None] for j in now})
    return blocks


def normalised_shapes(gap: Gap, effect: Effect) -> Array:
    """Shapes of an effect in normalised form, shape (s,)."""
    ranges = _ranges(gap, effect)
    return np.array([r.normalised(effect.values[r.shape.name]) for r in ranges])


def with_normalised_shapes(gap: Gap, effect: Effect, shapes: Array) -> Effect:
    """An effect with shapes given in normalised form, shape (s,)."""
    values = zip(_ranges(gap, effect), shapes, strict=True)
    return effect.at({r.shape.name: r.value(float(x)) for r, x in values})


def shape_units(gap: Gap, effect: Effect) -> list[float]:
    """Derivative of each shape's value with respect to its normalised form."""
    units, ranges = [], _ranges(gap, effect)
    for r, x in zip(ranges, normalised_shapes(gap, effect), strict=True):
        step = _STEP * _reach(effect, r)
        low, high = max(x - step, 0.0), min(x + step, 1.0)
        units.append((r.value(high) - r.value(low)) / (high - low))
    return units


def _ranges(gap: Gap, effect: Effect) -> list[Range]:
    scale = gap.scales[effect.joints[-1]]
    along = effect.shapes_along(gap.motions)
    shapes = [s.scaled(scale) for s in along if not s.whole]
    return [Range(_near(s, effect.values[s.name])) for s in shapes]


def _near(shape: Quantity, value: float) -> Quantity:
    """A shape with bounds around its value, if it is a time without upper bound."""
    if shape.upper <= _ENDLESS:
        return shape
    low, high = value - shape.typical, value + shape.typical
    return replace(shape, lower=max(low, shape.lower), upper=min(high, shape.upper))
