"""Which tests a mutant meets: the cheapest of all that execute its line.

What lies outside functions, a constant or a default, runs when its module is loaded; it
meets the tests that execute a line of the module that names it.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from mutation import ROOT, Mutant, digest, places

_BUDGET = 20.0  # s of processor time for one mutant's tests
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Witnesses:
    """Tests by what they execute.

    Attributes:
        costs: Processor time of every test that passes, [s].
        lines: Tests that execute a line, by module and the line's place in it.
        files: Hash of every test file when it was watched.
    """

    costs: dict[str, float]
    lines: dict[str, dict[str, list[str]]]
    files: dict[str, str]

    @classmethod
    def read(cls, file: Path) -> Witnesses:
        """Read what was watched; nothing if there is no such file."""
        if not file.exists():
            return cls({}, {}, {})
        kept = json.loads(file.read_text())
        tests, costs = kept["tests"], kept["costs"]
        lines = {
            path: {line: [tests[k] for k in which] for line, which in known.items()}
            for path, known in kept["lines"].items()
        }
        return cls(dict(zip(tests, costs, strict=True)), lines, kept["files"])

    def write(self, file: Path) -> None:
        """Write all to a file; tests of lines by their numbers, or it is large."""
        number = {test: k for k, test in enumerate(self.costs)}
        lines = {
            path: {line: [number[x] for x in tests] for line, tests in known.items()}
            for path, known in self.lines.items()
        }
        kept = {"tests": list(number), "costs": list(self.costs.values())}
        file.write_text(json.dumps({**kept, "lines": lines, "files": self.files}))

    def updated(self, new: Witnesses) -> Witnesses:
        """With what other test files execute, or the same ones anew."""
        lines = {
            path: {
                line: [x for x in tests if _file(x) not in new.files]
                for line, tests in known.items()
            }
            for path, known in self.lines.items()
        }
        for path, seen in new.lines.items():
            known = lines.setdefault(path, {})
            for line, tests in seen.items():
                known[line] = [*known.get(line, ()), *tests]
        kept = {x: s for x, s in self.costs.items() if _file(x) not in new.files}
        return Witnesses({**kept, **new.costs}, lines, {**self.files, **new.files})

    def of(self, mutant: Mutant) -> tuple[str, ...]:
        """Tests that may notice a mutant, cheapest file first."""
        text, executed = (ROOT / mutant.path).read_text(), self.lines.get(mutant.path)
        lines, found = places(text), set[str]()
        for row in _rows(text, mutant.row):
            found.update((executed or {}).get(lines[row - 1], ()))
        return self._affordable(found)

    def digest(self, mutant: Mutant) -> str:
        """Short hash of the tests that a mutant meets."""
        met = self.of(mutant)
        return digest(repr([(x, self.files[_file(x)]) for x in met]))

    def _affordable(self, tests: Iterable[str]) -> tuple[str, ...]:
        """The cheapest tests within the budget; tests of a file stay together."""
        ranked = sorted(tests, key=lambda x: (self.costs[x], x))
        sums = accumulate(self.costs[x] for x in ranked)
        kept = [x for x, s in zip(ranked, sums, strict=True) if s <= _BUDGET]
        files: dict[str, float] = {}
        for test in kept or ranked[:1]:
            files[_file(test)] = files.get(_file(test), 0.0) + self.costs[test]
        return tuple(sorted(kept or ranked[:1], key=lambda x: (files[_file(x)], x)))


def test_files() -> dict[str, str]:
    """Hash of every test file, with what all share."""
    shared = "".join(x.read_text() for x in sorted((ROOT / "tests").glob("[!t]*.py")))
    files = sorted((ROOT / "tests").glob("test_*.py"))
    return {f"tests/{x.name}": digest(shared + x.read_text()) for x in files}


def _file(test: str) -> str:
    return test.partition("::")[0]


def _rows(text: str, row: int) -> set[int]:
    """Lines by whose execution a test meets the statement at a line."""
    tree, lines = ast.parse(text), text.splitlines()
    around = [x for x in ast.walk(tree) if isinstance(x, ast.stmt) and row in _span(x)]
    *outer, statement = sorted(around, key=lambda x: -len(_span(x)))
    if isinstance(statement, _Function):
        return _body(statement)
    if any(isinstance(x, _Function) for x in outer):
        body = getattr(statement, "body", None)
        end = body[0].lineno if body else (statement.end_lineno or row) + 1
        return {row, *range(statement.lineno, end)}
    bodies = [_body(x) for x in ast.walk(tree) if isinstance(x, _Function)]
    inner = set[int]().union(*bodies)
    stored = [x for x in ast.walk(statement) if isinstance(x, ast.Name)]
    names = {x.id for x in stored if isinstance(x.ctx, ast.Store)}
    word = re.compile(rf"\b({'|'.join(map(re.escape, names))})\b") if names else None
    # Of a table over several lines, not each is executed by itself.
    naming = (x for x in bodies if word and any(word.search(lines[y - 1]) for y in x))
    return set[int]().union(*naming) or inner


def _span(x: ast.stmt) -> range:
    """Lines of a statement, with its decorators."""
    decorators = getattr(x, "decorator_list", [])
    first = min([x.lineno, *(y.lineno for y in decorators)])
    return range(first, (x.end_lineno or first) + 1)


def _body(function: _Function) -> set[int]:
    return {y for x in function.body for y in _span(x)}
