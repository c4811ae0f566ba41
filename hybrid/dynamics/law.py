"""Compilation of a tape to one Python function of numbers, or of arrays.

A few hundred operations on numbers then take some microseconds. On arrays they run at
the speed of the processor's cache.
"""

from __future__ import annotations

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
_MATH = {"power": "pow"}  # NumPy's name -> that of the module math
_FEW_SAMPLES = 16  # so few samples are faster one by one
_CHUNK = 4096  # samples at a time, which stay in the cache
_SPECIAL = {"inf": math.inf, "nan": math.nan}


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
        """Results at N instants, shape (N, results).

        Args:
            signals: Values of the first inputs, arrays of shape (N, any number).
            constants: Values of the other inputs.
        """
        samples = len(signals[0])
        if 0 < samples <= _FEW_SAMPLES:
            rows = np.concatenate(signals, axis=1).tolist()
            return np.array([self.at([*row, *constants]) for row in rows])
        out = np.empty((samples, len(self.results)))
        for start in range(0, samples, _CHUNK):
            part = slice(start, start + _CHUNK)
            columns = np.concatenate([x[part].T for x in signals]).astype(float)
            for k, x in enumerate(self._arrays(*columns, *constants)):
                out[part, k] = x
        return out

    def by(self, operations: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
        """A function from the inputs to a list of results, with another library.

        Args:
            operations: Functions of that library, by the names of ``OPERATIONS``.
        """
        return self._function({}, operations)

    @cached_property
    def _numbers(self) -> Callable[..., Any]:
        names = {x: getattr(math, _MATH.get(x, x), None) for x in OPERATIONS}
        return self._function(_SCALAR_TEMPLATES, names)

    @cached_property
    def _arrays(self) -> Callable[..., Any]:
        return self._function(
            _ARRAY_TEMPLATES, {**OPERATIONS, "sine_cosine": sine_cosine}
        )

    def _function(
        self, templates: Mapping[str, str], names: Mapping[str, Any]
    ) -> Callable[..., Any]:
        """Compile; the text has only operations and numbers, and no name of a file."""
        given = ", ".join(f"i{k}" for k in range(len(self.inputs)))
        lines = "".join(f"    {line}\n" for line in self._lines(templates))
        space: dict[str, Any] = {**names, **_SPECIAL}
        exec(f"def law({given}):\n{lines}", space)
        function: Callable[..., Any] = space["law"]
        return function

    def _lines(self, templates: Mapping[str, str]) -> Iterator[str]:
        """Assignments; a variable is reused as soon as its value is not needed."""
        tape, needed = self.tape, self.tape.needed(self.results)
        last: dict[int, int] = {}
        for line in needed:
            last |= dict.fromkeys(_lines_of(tape, line), line)
        last |= dict.fromkeys(
            (x.line for x in self.results if isinstance(x, Symbol)), len(tape.lines)
        )
        variable = {
            line: f"i{self.inputs.index(str(operation.arguments[0]))}"
            for line, operation in enumerate(tape.lines)
            if operation.name == "input" and line in last
        }
        free: list[str] = []
        count = 0
        for line in needed:
            operation = tape.lines[line]
            if operation.name == "input":
                continue
            if line in variable:  # computed together with its sine or cosine
                continue
            given = [
                variable[x] if isinstance(x, int) else f"({x!r})"
                for x in operation.arguments
            ]
            finished = [x for x in set(_lines_of(tape, line)) if last[x] == line]
            free += [variable[x] for x in finished if variable[x].startswith("x")]
            pair = self._pairs.get(line, ()) if templates is _ARRAY_TEMPLATES else ()
            for x in pair or (line,):
                if not free:
                    free.append(f"x{count}")
                    count += 1
                variable[x] = free.pop()
            if pair:
                both = ", ".join(variable[x] for x in pair)
                yield f"{both} = sine_cosine({given[0]})"
                continue
            plain = f"{operation.name}({', '.join(['{}'] * len(given))})"
            text = templates.get(operation.name, plain).format(*given)
            yield f"{variable[line]} = {text}"
        results = (
            variable[x.line] if isinstance(x, Symbol) else repr(float(x))
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


def _lines_of(tape: Tape, line: int) -> list[int]:
    """Lines that are arguments of a line."""
    operation = tape.lines[line]
    if operation.name == "input":
        return []
    return [x for x in operation.arguments if isinstance(x, int)]
