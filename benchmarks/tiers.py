"""Which tests a mutant meets: those named for its module, and after them all near it.

The first tier is quick and finds most. What survives it meets the second: the slow
tests of the same files, and the files that are named for other modules of its folder.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from mutation import ROOT, SETTINGS, digest


@dataclass(frozen=True)
class Tier:
    """Some tests; also a plugin of pytest that leaves out the others.

    Attributes:
        files: Test files to collect.
        quick: Files whose slow tests are left out.
        met: Files of which only the slow tests are kept.
    """

    files: tuple[str, ...]
    quick: tuple[str, ...] = ()
    met: tuple[str, ...] = ()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what belongs to this tier."""
        items[:] = [item for item in items if self.holds(item.nodeid)]

    def holds(self, test: str) -> bool:
        """Whether a test, named as pytest does, belongs to this tier."""
        slow, file = test.startswith(tuple(SETTINGS["slow"])), test.split("::")[0]
        return slow if file in self.met else not (slow and file in self.quick)

    @property
    def digest(self) -> str:
        """Short hash of these tests, and of what all tests share."""
        shared = sorted((ROOT / "tests").glob("[!t]*.py"))
        text = "".join(
            x.read_text() for x in (*shared, *(ROOT / x for x in self.files))
        )
        return digest(text + repr(self.met))


def tiers(path: str) -> tuple[Tier, Tier]:
    """Both tiers of a module's tests."""
    named = SETTINGS["tests"]
    own = max((x for x in named if path.startswith(x)), key=len)
    folder = "/".join(path.split("/")[:2])
    first = _files(named[own])
    near = [x for key in sorted(named) if key.startswith(folder) for x in named[key]]
    both = tuple(dict.fromkeys((*first, *_files(near))))
    return Tier(first, quick=first), Tier(both, met=first)


def _files(names: list[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(f"tests/test_{x}.py" for x in names))
