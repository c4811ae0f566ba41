"""Convert units of files to SI, by pint."""

import re
from functools import cache
from typing import Any

import numpy as np

from hybrid.arrays import AnyArray, Array

SI = {
    "time": ("s",),
    "q": ("rad", "m"),
    "v": ("rad/s", "m/s"),
    "command": ("rad", "m"),
    "tau": ("N*m", "N"),
    "current": ("A",),
    "temperature": ("degC",),
}
# Spellings that pint does not know.
_SPELLED = {
    "rad_s": "rad/s", "rad_per_s": "rad/s", "deg_s": "deg/s", "deg_per_s": "deg/s",
    "C": "degC", "Deg": "deg", "Degrees": "deg",
}  # fmt: skip
_TORQUE = re.compile(r"([mk]?N)[ _.⋅-]?([cm]?m)")  # Nm, N_m, N-m, mNm, Nmm
_PLAIN = re.compile(r"[A-Za-zµμ°*/^ ·.²-]{1,16}(-1)?")
EPOCH = 1e9  # s; later times count from 1970


def converted(unit: str, channel: str) -> tuple[float, float] | None:
    """Factor and offset from a unit to SI; None if it is no unit of the channel."""
    unit = unit.strip()
    unit = _SPELLED.get(unit, unit).replace("·", "*").replace("°", "deg")
    if match := _TORQUE.fullmatch(unit):
        unit = "*".join(match.groups())
    if unit in SI[channel]:
        return 1.0, 0.0
    return _by_pint(unit, channel)


def fits(unit: str, channel: str = "") -> bool:
    """Tell whether a text is a unit of a channel; by default, of any channel."""
    channels = (channel,) if channel else tuple(SI)
    return any(converted(unit, name) is not None for name in channels)


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)


@cache
def _by_pint(unit: str, channel: str) -> tuple[float, float] | None:
    if not _PLAIN.fullmatch(unit):
        return None
    registry = _registry()
    try:
        parsed = registry.Unit(unit)
        root = registry.get_root_units(parsed)[1]
        for target in SI[channel]:
            # Root units, not dimensions: for pint, counts and radians have none.
            if root != registry.get_root_units(target)[1]:
                continue
            zero, one = (registry.Quantity(x, parsed).to(target).m for x in (0.0, 1.0))
            return float(one - zero), float(zero)
    except Exception:  # pint's parser raises any type for a text that is no unit
        return None
    return None


def seconds(x: AnyArray, unit: str) -> tuple[Array, str]:
    """Convert a clock to seconds; return it with its original unit.

    If the unit is not stated, it follows from the size of times that count from 1970.
    Such times count from the first one afterwards, so that no digit is lost, unless
    they are in seconds.
    """
    if x.dtype.kind == "M":
        x, unit = x.astype("datetime64[ns]").astype(np.int64), "ns"
    if not unit:
        first = float(x[0]) if len(x) else 0.0
        sizes = {1e3: "ms", 1e6: "us", 1e9: "ns"}
        unit = next((u for s, u in sizes.items() if 1 <= first / s / EPOCH < 4.2), "s")
    factor, _ = converted(unit, "time") or (1.0, 0.0)
    if factor == 1.0:
        return np.asarray(x, dtype=np.float64), unit
    if len(x) and float(x[0]) * factor >= EPOCH:
        x = x - x[0]
    parts = 1 / factor
    whole = abs(parts - round(parts)) < 1e-6 * parts
    x = np.asarray(x, dtype=np.float64)
    return (x / round(parts) if whole and parts > 1 else x * factor), unit
