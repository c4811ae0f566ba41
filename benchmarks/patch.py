"""One changed function, to be given to the package while it runs."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType
from typing import Any

from mutation import Mutant


@dataclass(frozen=True)
class Patch:
    """Other code of one function.

    Attributes:
        path: The module, from the root of the tree.
        names: Classes and function in which it is, outermost first.
        line: First line of the function.
        code: What it shall do.
    """

    path: str
    names: tuple[str, ...]
    line: int
    code: CodeType

    def apply(self) -> None:
        """Give the function its other code, wherever it is known already."""
        found: Any = importlib.import_module(
            self.path.removesuffix(".py").replace("/", ".")
        )
        for name in self.names:
            found = vars(found)[name]
        for function in _functions(found):
            if function.__code__.co_firstlineno == self.line:
                function.__code__ = self.code
                return
        raise LookupError(f"{self.path}: no function {'.'.join(self.names)}")


def patch_of(source: str, mutant: Mutant) -> Patch | None:
    """The patch that makes a mutant of a module; None if it is not just a function.

    A function without a name does not count: it ran when its module was loaded.

    Args:
        source: The module's text.
        mutant: The mutant.
    """
    before, after = (compile(x, mutant.path, "exec") for x in (source, mutant.source()))
    pairs = list(zip(_bodies(before), _bodies(after), strict=True))
    changed = [(names, x, y) for (names, x), (_, y) in pairs if x != y]
    if len(changed) != 1 or _shell(before) != _shell(after):
        return None
    names, old, new = changed[0]
    if old.co_freevars != new.co_freevars or names[-1].startswith("<"):
        return None
    return Patch(mutant.path, names, new.co_firstlineno, new)


def _bodies(code: CodeType) -> Iterator[tuple[tuple[str, ...], CodeType]]:
    """Functions of a module and of its classes, with the names that lead to them."""
    for x in code.co_consts:
        if isinstance(x, CodeType):
            if x.co_flags & 0x2:  # a function: its variables are numbered
                yield (x.co_name,), x
            else:
                yield from (((x.co_name, *names), y) for names, y in _bodies(x))


def _shell(code: CodeType) -> Any:
    """What a module or class does beside defining functions."""
    inner = [
        _shell(x) if isinstance(x, CodeType) and not x.co_flags & 0x2 else
        "function" if isinstance(x, CodeType) else repr(x)
        for x in code.co_consts
    ]  # fmt: skip
    return code.co_code, code.co_names, inner


def _functions(x: Any) -> Iterator[Any]:
    """Functions that an attribute is, or is made of."""
    if hasattr(x, "__code__"):
        yield x
    for name in ("__func__", "__wrapped__", "func", "fget", "fset"):
        inner = getattr(x, name, None)
        if inner is not None and inner is not x:
            yield from _functions(inner)
