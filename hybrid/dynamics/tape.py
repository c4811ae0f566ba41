"""A tape of scalar operations, from which fast Python, C and ONNX are made.

Arithmetic and NumPy functions on a :class:`Symbol` are recorded instead of computed. So
the laws that simulate and fit an arm are also compiled and exported. Constants are
folded, and common subexpressions are recorded once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from hybrid.errors import HybridError

# Operation -> function of numbers. Names are those of NumPy.
OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": np.add, "subtract": np.subtract, "multiply": np.multiply,
    "divide": np.divide, "power": np.power, "negative": np.negative,
    "absolute": np.abs, "sign": np.sign, "sqrt": np.sqrt, "exp": np.exp,
    "log": np.log, "sin": np.sin, "cos": np.cos, "tanh": np.tanh,
    "minimum": np.minimum, "maximum": np.maximum, "where": np.where,
    "less": np.less, "less_equal": np.less_equal,
    "greater": np.greater, "greater_equal": np.greater_equal,
}  # fmt: skip
# Derivatives of operations by their arguments, as far as rigid bodies need them.
_SLOPES: Mapping[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda x, y: (1.0, 1.0), "subtract": lambda x, y: (1.0, -1.0),
    "multiply": lambda x, y: (y, x), "negative": lambda x: (-1.0,),
    "sin": lambda x: (np.cos(x),), "cos": lambda x: (-np.sin(x),),
}  # fmt: skip
_SAME = {"true_divide": "divide", "float_power": "power"}
_MOST_FACTORS = 4  # of an integer power that is recorded as products


@dataclass(frozen=True)
class Operation:
    """One line of a tape.

    Attributes:
        name: One of ``OPERATIONS``, or ``input``.
        arguments: Lines and numbers; the name for an input.
    """

    name: str
    arguments: tuple[int | float | str, ...]


class Tape:
    """Operations in an order in which they can be computed."""

    def __init__(self) -> None:
        self.lines: list[Operation] = []
        self._lines_by_key: dict[Any, int] = {}

    def input(self, name: str) -> Any:
        """The symbol of an input."""
        return Symbol(self, self._line("input", (name,)))

    def apply(self, name: str, *arguments: Any) -> Any:
        """Record an operation; returns a symbol, or a number if it is constant."""
        name = _SAME.get(name, name)
        if name not in OPERATIONS:
            raise HybridError(
                f"{name} cannot be exported; valid are {', '.join(OPERATIONS)}"
            )
        plain = [x if isinstance(x, Symbol) else float(x) for x in arguments]
        if not any(isinstance(x, Symbol) for x in plain):
            return float(OPERATIONS[name](*plain))
        simpler = _simplified(name, plain)
        if simpler is not None:
            return simpler
        lines = tuple(x.line if isinstance(x, Symbol) else x for x in plain)
        return Symbol(self, self._line(name, lines))

    def needed(self, results: Sequence[Any]) -> list[int]:
        """Lines on which the results depend, in order."""
        found = {x.line for x in results if isinstance(x, Symbol)}
        for line in reversed(range(len(self.lines))):
            if line in found:
                found.update(self.arguments(line))
        return sorted(found)

    def arguments(self, line: int) -> list[int]:
        """Lines that are arguments of a line."""
        return [x for x in self.lines[line].arguments if isinstance(x, int)]

    def gradient(
        self, results: Sequence[Symbol], seeds: Sequence[Any], inputs: Sequence[Symbol]
    ) -> list[Any]:
        """Derivatives of ``sum(seed * result)`` by inputs, in reverse mode."""
        slope: dict[int, Any] = defaultdict(float)  # of the sum by each line
        for result, seed in zip(results, seeds, strict=True):
            slope[result.line] = slope[result.line] + seed
        for line in reversed(self.needed(results)):
            name, arguments = self.lines[line].name, self.lines[line].arguments
            if name == "input":
                continue
            x = [Symbol(self, y) if isinstance(y, int) else y for y in arguments]
            for argument, factor in zip(arguments, _SLOPES[name](*x), strict=True):
                if isinstance(argument, int):
                    slope[argument] = slope[argument] + slope[line] * factor
        return [slope[x.line] for x in inputs]

    def _line(self, name: str, arguments: tuple[Any, ...]) -> int:
        key = (name, *((type(x), x) for x in arguments))
        if key not in self._lines_by_key:
            self._lines_by_key[key] = len(self.lines)
            self.lines.append(Operation(name, arguments))
        return self._lines_by_key[key]


class Symbol(NDArrayOperatorsMixin):
    """A number on a tape."""

    def __init__(self, tape: Tape, line: int) -> None:
        self.tape, self.line = tape, line

    def __array_ufunc__(
        self, function: np.ufunc, method: str, *inputs: Any, **options: Any
    ) -> Any:
        if method != "__call__" or options:
            raise HybridError(f"{function.__name__}.{method} cannot be exported")
        return self.tape.apply(function.__name__, *inputs)

    def __array_function__(
        self, function: Any, types: Any, args: Any, kwargs: Any
    ) -> Any:
        if function is np.where:
            return self.tape.apply("where", *args)
        if function is np.clip and not kwargs:
            x, low, high = args
            x = x if low is None else self.tape.apply("maximum", x, low)
            return x if high is None else self.tape.apply("minimum", x, high)
        raise HybridError(f"numpy.{function.__name__} cannot be exported")

    def __bool__(self) -> bool:
        raise HybridError("a law that is exported cannot branch; use numpy.where")

    __eq__, __hash__ = object.__eq__, object.__hash__


def _simplified(name: str, x: list[Any]) -> Any:
    """A simpler equivalent of an operation, or None; inputs are finite, so 0·x is 0."""
    if name == "power" and x[1] in range(1, _MOST_FACTORS + 1):
        product = x[0]
        for _ in range(int(x[1]) - 1):
            product = product * x[0]
        return product
    match name, x:
        case ("add", [0.0, y] | [y, 0.0]) | ("multiply", [1.0, y] | [y, 1.0]):
            return y
        case ("subtract", [y, 0.0]) | ("divide", [y, 1.0]):
            return y
        case ("multiply", [0.0, _] | [_, 0.0]) | ("divide", [0.0, _]):
            return 0.0
        case ("multiply", [-1.0, y] | [y, -1.0]) | ("subtract", [0.0, y]):
            return -y
    return None
