"""Which changes of the code Cosmic Ray can make, and the draw of some of them."""

from __future__ import annotations

import ast
import hashlib
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutants"]

# One other operator for each. Left out are a bit shift of a float, which fails at once;
# < against ≤, which differ on single points of the real numbers only (whole numbers are
# changed by one instead); decorators, without which nothing loads; and the star before
# arguments that must be named.
_BINARY = {
    "Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "FloorDiv": "Mul",
    "Mod": "Add", "Pow": "Mul", "BitOr": "BitAnd", "BitAnd": "BitOr",
}  # fmt: skip
_COMPARISON = {
    "Lt": "GtE", "LtE": "Gt", "Gt": "LtE", "GtE": "Lt", "Eq": "NotEq", "NotEq": "Eq",
    "Is": "IsNot", "IsNot": "Is",
}  # fmt: skip
OPERATORS = (
    *(f"ReplaceBinaryOperator_{x}_{y}" for x, y in _BINARY.items()),
    *(f"ReplaceComparisonOperator_{x}_{y}" for x, y in _COMPARISON.items()),
    "ReplaceUnaryOperator_USub_UAdd",
    "ReplaceUnaryOperator_Delete_Not",
    "AddNot",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ExceptionReplacer",
    "NumberReplacer",
    "ZeroIterationForLoop",
)


@dataclass(frozen=True)
class Mutant:
    """One change of one module.

    Attributes:
        path: The module, from the root of the tree.
        operator: Name of the operator.
        occurrence: Which of its places in the module.
        place: The line's text, and which of its places in equal lines; it stays the
            same when other lines change.
        row: Number of the line, from one.
    """

    path: str
    operator: str
    occurrence: int
    place: str
    row: int = field(compare=False, default=0)

    @cached_property
    def key(self) -> str:
        """Short name that does not depend on the rest of the module."""
        return digest("\0".join((self.path, self.operator, self.place)))

    def source(self) -> str:
        """The module's text with the change."""
        operator = get_operator(f"core/{self.operator}")()
        text = (ROOT / self.path).read_text()
        found = MutationVisitor.mutate_code(text, operator, self.occurrence)
        assert found is not None, self
        return str(found)


def digest(text: str) -> str:
    """Short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def drawn(seed: int, count: int, only: tuple[str, ...] = ()) -> list[Mutant]:
    """Some of all mutants, in the order of a hash: a change elsewhere draws no others.

    Args:
        seed: Which ones.
        count: How many.
        only: Modules or folders to stay within; the core if empty.
    """
    modules = sorted(
        path.relative_to(ROOT).as_posix()
        for name in SETTINGS["core"]
        for path in [ROOT / name, *(ROOT / name).rglob("*.py")]
        if path.suffix == ".py" and path.name != "__init__.py"
    )
    chosen = [m for m in dict.fromkeys(modules) if m.startswith(only or ("hybrid/",))]
    found = [mutant for path in chosen for mutant in mutants(path)]
    ranked = sorted(found, key=lambda m: _rank(seed, m))
    return list(islice(filter(_compiles, ranked), count))


def mutants(path: str) -> Iterator[Mutant]:
    """All mutants of a module."""
    text = (ROOT / path).read_text()
    lines, unused = text.splitlines(), _annotations(text)
    nodes = list(ast_nodes(get_ast(text)))
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        places = [(x, p) for x in nodes for p, _ in operator.mutation_positions(x)]
        seen: dict[str, int] = {}
        for occurrence, (node, (row, column)) in enumerate(places):
            line = lines[row - 1].strip()
            seen[line] = seen.get(line, -1) + 1
            marker = node.parent is not None and node.parent.type == "parameters"
            if not (marker or any(a <= (row, column) < b for a, b in unused)):
                yield Mutant(path, name, occurrence, f"{line}\0{seen[line]}", row)


def places(text: str) -> list[str]:
    """A name for every line, which stays the same when other lines change."""
    seen: Counter[str] = Counter()
    found = []
    for line in map(str.strip, text.splitlines()):
        found.append(f"{line}\0{seen[line]}")
        seen[line] += 1
    return found


def _compiles(mutant: Mutant) -> bool:
    """Whether the change can be made and is Python.

    The stars of ``{**x}`` are no power, and Cosmic Ray replaces no ``module.Error``.
    """
    try:
        ast.parse(mutant.source())
    except (AttributeError, SyntaxError):
        return False
    return True


def _rank(seed: int, mutant: Mutant) -> str:
    return hashlib.sha256(f"{seed}:{mutant.key}".encode()).hexdigest()


def _annotations(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Where annotations are, which nothing evaluates: (row, column) from and to."""
    found = []
    for node in ast.walk(ast.parse(text)):
        for name in ("annotation", "returns"):
            x = getattr(node, name, None)
            if x is not None:
                end = (x.end_lineno, x.end_col_offset)
                found.append(((x.lineno, x.col_offset), end))
    return found
