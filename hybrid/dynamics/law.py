"""Compilation of a tape to one Python function of numbers, or of arrays.

A few hundred operations on numbers then take some microseconds. On arrays they run at
the speed of the processor's cache.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.tape import OPERATIONS, Symbol, Tape

_ARRAY_TEMPLATES = {
    "add": "{} + {}", "subtract": "{} - {}", "multiply": "{} * {}",
    "divide": "{} / {}", "negative": "-{}",
    "less": "{} < {}", "less_equal": "{} <= {}",
    "greater": "{} > {}", "greater_equal": "{} >= {}",
}  # fmt: skip
_SCALAR_TEMPLATES = _ARRAY_TEMPLATES | {
    "absolute": "abs({})", "sign": "float(({0} > 0.0) - ({0} < 0.0))",
    "where": "{1} if {0} else {2}",
    "minimum": "{0} if {0} < {1} else {1}", "maximum": "{0} if {0} > {1} else {1}",
}  # fmt: skip
_FEW_SAMPLES = 16  # so few samples are faster one by one
_CHUNK = 8192  # samples at a time, which stay in the cache


@dataclass(frozen=True, eq=False)
class Law:
    """Results of a tape as functions of its inputs.

    Attributes:
        tape: The operations.
        results: Symbols of the tape, and numbers.
        inputs: Names of the tape's inputs, in the order of the values.
    """

    tape: Tape
    results: tuple[Any, ...]
    inputs: tuple[str, ...]

    def at(self, values: Sequence[float]) -> Sequence[float]:
        """Results at one instant."""
        try:
            found: Sequence[float] = self._numbers(*values)
        except (ArithmeticError, ValueError):  # NumPy gives inf or NaN instead
            found = [float(x) for x in self._arrays(*np.array(values, float))]
        return found

    def along(self, signals: Sequence[Array], constants: Sequence[float] = ()) -> Array:
        """Results at N instants, shape (N, results); see :meth:`rows`."""
        return np.ascontiguousarray(self.rows(signals, constants).T)

    def rows(self, signals: Sequence[Array], constants: Sequence[float] = ()) -> Array:
        """Results at N instants, shape (results, N).

        Args:
            signals: Values of the first inputs, arrays of shape (N, any number).
            constants: Values of the other inputs.
        """
        samples = len(signals[0])
        out = np.empty((len(self.results), samples))
        if samples <= _FEW_SAMPLES:
            for k, row in enumerate(np.concatenate(signals, axis=1).tolist()):
                out[:, k] = self.at([*row, *constants])
            return out
        for start in range(0, samples, _CHUNK):
            part = slice(start, start + _CHUNK)
            columns = np.concatenate([x[part].T for x in signals]).astype(float)
            for k, x in enumerate(self._arrays(*columns, *constants)):
                out[k, part] = x
        return out

    def by(self, operations: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
        """A function from the inputs to a list of results, with another library.

        Args:
            operations: Functions of that library, by the names of ``OPERATIONS``.
        """
        return self._function({}, operations)

    @cached_property
    def _numbers(self) -> Callable[..., Any]:
        names = {x: getattr(math, x, None) for x in OPERATIONS}
        return self._function(_SCALAR_TEMPLATES, names | {"power": math.pow})

    @cached_property
    def _arrays(self) -> Callable[..., Any]:
        return self._function(_ARRAY_TEMPLATES, OPERATIONS)

    def _function(
        self, templates: Mapping[str, str], names: Mapping[str, Any]
    ) -> Callable[..., Any]:
        """Compile; the text has only operations and numbers, and no name of a file."""
        given = (f"x{self.tape.input(name).line}" for name in self.inputs)
        lines = "".join(f"    {line}\n" for line in self._lines(templates))
        own = {"inf": math.inf, "nan": math.nan, "sine_cosine": sine_cosine}
        space: dict[str, Any] = {**names, **own}
        exec(f"def law({', '.join(given)}):\n{lines}", space)
        function: Callable[..., Any] = space["law"]
        return function

    def _lines(self, templates: Mapping[str, str]) -> Iterator[str]:
        """Assignments; a value is deleted as soon as it is not needed."""
        tape, needed = self.tape, self.tape.needed(self.results)
        last = {x: line for line in needed for x in tape.arguments(line)}
        kept = {x.line for x in self.results if isinstance(x, Symbol)}
        pairs = self._pairs if templates is _ARRAY_TEMPLATES else {}
        for line in needed:
            name, arguments = tape.lines[line].name, tape.lines[line].arguments
            given = [f"x{x}" if isinstance(x, int) else f"({x!r})" for x in arguments]
            if line in pairs and line == min(pairs[line]):
                sine, cosine = pairs[line]
                yield f"x{sine}, x{cosine} = sine_cosine({given[0]})"
            elif line not in pairs and name != "input":
                call = f"{name}({', '.join(['{}'] * len(given))})"
                yield f"x{line} = {templates.get(name, call).format(*given)}"
            for x in set(tape.arguments(line)) - kept:
                if last[x] == line:
                    yield f"del x{x}"
        results = (
            f"x{x.line}" if isinstance(x, Symbol) else repr(float(x))
            for x in self.results
        )
        yield f"return [{', '.join(results)}]"

    @cached_property
    def _pairs(self) -> dict[int, tuple[int, int]]:
        """Line of a sine or cosine -> lines of sine and cosine of the same argument."""
        of: dict[Any, dict[str, int]] = {}
        for line in self.tape.needed(self.results):
            operation = self.tape.lines[line]
            if operation.name in ("sin", "cos"):
                of.setdefault(operation.arguments, {})[operation.name] = line
        both = [(x["sin"], x["cos"]) for x in of.values() if len(x) == 2]
        return {line: pair for pair in both for line in pair}


def sine_cosine(x: Array) -> tuple[Array, Array]:
    """Sine and cosine from the tangent of the half angle, which is faster in NumPy.

    The error is at most two units in the last place.
    """
    t = np.tan(0.5 * x)
    square = t * t
    share = 1.0 / (1.0 + square)
    return (t + t) * share, (1.0 - square) * share
