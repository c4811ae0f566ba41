"""Which tests a mutant meets: the cheapest of all that execute its line.

What several tests share, such as a fixture, is made and paid once.

What lies outside functions, a constant or a default, runs when its module is loaded; it
meets the tests that execute a line that names it, of its module or else of another.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mutation import ROOT, Mutant, digest, places

_BUDGET = 10.0  # s of processor time for one mutant's tests
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Witnesses:
    """Tests by what they execute.

    Attributes:
        costs: Processor time of every test that passes, and of what several share, [s].
        lines: Tests that execute a line, by module and the line's place in it.
        files: Hash of every test file when it was watched.
        needs: Fixtures and cached functions that a test takes, each made once.
    """

    costs: dict[str, float]
    lines: dict[str, dict[str, list[str]]]
    files: dict[str, str]
    needs: dict[str, list[str]]

    @classmethod
    def read(cls, file: Path) -> Witnesses:
        """Read what was watched; nothing if there is no such file."""
        if not file.exists():
            return cls({}, {}, {}, {})
        kept = json.loads(file.read_text())
        tests = list(kept["needs"])
        lines = {
            path: {line: [tests[k] for k in which] for line, which in known.items()}
            for path, known in kept["lines"].items()
        }
        return cls(kept["costs"], lines, kept["files"], kept["needs"])

    def write(self, file: Path) -> None:
        """Write all to a file; tests of lines by their numbers, or it is large."""
        number = {test: k for k, test in enumerate(self.needs)}
        lines = {
            path: {line: [number[x] for x in tests] for line, tests in known.items()}
            for path, known in self.lines.items()
        }
        file.write_text(json.dumps({**vars(self), "lines": lines}))

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
        needs = {x: n for x, n in self.needs.items() if _file(x) not in new.files}
        needs |= new.needs
        named = {*needs, *(x for shared in needs.values() for x in shared)}
        costs = {x: s for x, s in {**self.costs, **new.costs}.items() if x in named}
        return Witnesses(costs, lines, {**self.files, **new.files}, needs)

    def of(self, mutant: Mutant) -> tuple[str, ...]:
        """Tests that may notice a mutant, cheapest file first."""
        text = (ROOT / mutant.path).read_text()
        found = self._executing(mutant.path, _rows(text, mutant.row))
        if not found:  # a constant that only other modules take
            *outer, statement = _around(text, mutant.row)
            before = r"\." if outer else r"\b"  # of a class, or of the module
            for path in (x for x in self.lines if x.endswith(".py")):
                if not (ROOT / path).exists():  # it was there when tests were watched
                    continue
                naming = _naming((ROOT / path).read_text(), _names(statement), before)
                found |= self._executing(path, naming)
        return self._affordable(found)

    def _executing(self, path: str, rows: Iterable[int]) -> set[str]:
        """Tests that execute one of some lines of a module."""
        names, executed = places((ROOT / path).read_text()), self.lines.get(path, {})
        return {x for row in rows for x in executed.get(names[row - 1], ())}

    def digest(self, mutant: Mutant) -> str:
        """Short hash of the tests that a mutant meets."""
        met = self.of(mutant)
        return digest(repr([(x, self.files[_file(x)]) for x in met]))

    def price(self, tests: Iterable[str]) -> float:
        """Processor time of some tests, with what they share once, [s]."""
        named = {x for test in tests for x in (test, *self.needs[test])}
        return sum(map(self.costs.__getitem__, named))

    def _affordable(self, tests: Iterable[str]) -> tuple[str, ...]:
        """The cheapest tests within the budget, those of a file together."""
        kept: list[str] = []
        paid: set[str] = set()
        spent = 0.0
        for test in sorted(tests, key=lambda x: (self.price([x]), x)):
            own = {test, *self.needs[test]} - paid
            more = sum(map(self.costs.__getitem__, own))
            if not kept or spent + more <= _BUDGET:
                kept.append(test)
                paid |= own
                spent += more
        first = {_file(x): -k for k, x in enumerate(reversed(kept))}
        return tuple(sorted(kept, key=lambda x: first[_file(x)]))


def test_files() -> dict[str, str]:
    """Hash of every test file, with what it imports from beside it."""
    texts = {x.stem: x.read_text() for x in (ROOT / "tests").glob("*.py")}
    return {
        f"tests/{name}.py": digest("".join(texts[x] for x in _needed(name, texts)))
        for name in sorted(texts)
        if name.startswith("test_")
    }


def _needed(name: str, texts: Mapping[str, str]) -> list[str]:
    """A test file and the modules beside it that it takes, through others too."""
    found: set[str] = set()
    open_ = ["conftest", name]
    while open_:
        found.add(x := open_.pop())
        named = re.findall(r"^\s*(?:from|import) (\w+)", texts[x], re.MULTILINE)
        open_ += (set(named) & set(texts)) - found
    return sorted(found)


def _file(test: str) -> str:
    return test.partition("::")[0]


def _rows(text: str, row: int) -> set[int]:
    """Lines by whose execution a test meets the statement at a line."""
    *outer, statement = _around(text, row)
    if isinstance(statement, _Function):
        return _body(statement)
    if any(isinstance(x, _Function) for x in outer):
        body = getattr(statement, "body", None)
        end = body[0].lineno if body else (statement.end_lineno or row) + 1
        return {row, *range(statement.lineno, end)}
    functions = (x for x in ast.walk(ast.parse(text)) if isinstance(x, _Function))
    return _naming(text, _names(statement)) or set[int]().union(*map(_body, functions))


def _around(text: str, row: int) -> list[ast.stmt]:
    """Statements around a line, outermost first."""
    every = (x for x in ast.walk(ast.parse(text)) if isinstance(x, ast.stmt))
    return sorted((x for x in every if row in _span(x)), key=lambda x: -len(_span(x)))


def _names(statement: ast.stmt) -> set[str]:
    """Names to which a statement gives a value."""
    stored = (x for x in ast.walk(statement) if isinstance(x, ast.Name))
    return {x.id for x in stored if isinstance(x.ctx, ast.Store)}


def _naming(text: str, names: set[str], before: str = r"\b") -> set[int]:
    """Lines of the functions that name one of some names, after a pattern."""
    if not names:
        return set()
    word, lines = re.compile(rf"{before}({'|'.join(names)})\b"), text.splitlines()
    functions = (x for x in ast.walk(ast.parse(text)) if isinstance(x, _Function))
    # Of a table over several lines, not each is executed by itself.
    bodies = (
        x for x in map(_body, functions) if any(word.search(lines[y - 1]) for y in x)
    )
    return set[int]().union(*bodies)


def _span(x: ast.stmt) -> range:
    """Lines of a statement, with its decorators."""
    decorators = getattr(x, "decorator_list", [])
    first = min([x.lineno, *(y.lineno for y in decorators)])
    return range(first, (x.end_lineno or first) + 1)


def _body(function: _Function) -> set[int]:
    return {y for x in function.body for y in _span(x)}
