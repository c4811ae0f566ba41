"""A scalar with its unit, bounds and uncertainty."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from hybrid.errors import HybridError
from hybrid.shown import plain


@dataclass(frozen=True)
class Parameter:
    """One scalar of a model.

    Attributes:
        name: Field's standard term, e.g. ``"level"``.
        value: Current value, in ``unit``.
        lower: Smallest physically valid value, in ``unit``.
        upper: Largest physically valid value, in ``unit``.
        unit: SI unit, ``""`` when dimensionless.
        std: Standard deviation of the estimate, in ``unit``; NaN when not estimated.

    Raises:
        HybridError: ``value`` is NaN or outside the bounds.
    """

    name: str
    value: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = ""
    std: float = math.nan

    def __post_init__(self) -> None:
        if not self.lower <= self.value <= self.upper:
            raise HybridError(
                f"parameter {self.name!r} is {self.value:g} {self.unit}, "
                f"valid is {self.lower:g} to {self.upper:g} {self.unit}"
            )

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready fields; non-finite numbers become ``None``."""
        return dict(plain(asdict(self)))
