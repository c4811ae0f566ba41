"""Which lines of the package a test executes: a plugin of pytest, around coverage.py.

What a fixture or a cached function of several tests executes is charged to each of
them, not to the first that asked for it.
"""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coverage
import pytest
from mutation import places
from witnesses import Witnesses

_IMPORT = "import"


class Recorder:
    """Records lines and processor time of every test that passes.

    Args:
        root: The tree whose package is watched.
        files: Test files that run, with their hashes.
        out: File to write `Witnesses` to.
    """

    def __init__(self, root: Path, files: dict[str, str], out: Path) -> None:
        self.root, self.files, self.out = root, files, out
        self.coverage = coverage.Coverage(
            data_file=None, source=[str(root / "hybrid")], config_file=False
        )
        # A file whose tests are all skipped, or run commands, executes nothing here.
        self.coverage.set_option("run:disable_warnings", ["no-data-collected"])
        self.stack = [_IMPORT]
        self.uses: dict[str, set[str]] = defaultdict(set)
        self.cost: dict[str, float] = defaultdict(float)  # without what is shared
        self.since = time.process_time()
        self.failed: set[str] = set()

    def start(self) -> None:
        """Watch from here on; modules that are loaded later have watched caches."""
        self.coverage.start()
        self.coverage.switch_context(_IMPORT)
        plain = functools.lru_cache
        functools.cache = lambda f: self._cached(f, plain(maxsize=None))
        functools.lru_cache = lambda maxsize=128, typed=False: (
            self._cached(maxsize, plain())
            if callable(maxsize)
            else lambda f: self._cached(f, plain(maxsize, typed))
        )

    def _cached(self, f: Any, cache: Callable[[Any], Any]) -> Any:
        """A cached function whose lines count for all that call it with the same."""
        if not getattr(f, "__code__", None) or not f.__code__.co_filename.startswith(
            str(self.root)
        ):
            return cache(f)

        def name(*given: Any) -> str:
            return f"cache {f.__module__}.{f.__qualname__} {hash(given):x}"

        @functools.wraps(f)
        def fresh(*args: Any, **kwargs: Any) -> Any:
            with self._within(name(args, *kwargs.items())):
                return f(*args, **kwargs)

        kept = cache(fresh)

        @functools.wraps(f)
        def called(*args: Any, **kwargs: Any) -> Any:
            self.uses[self.stack[-1]].add(name(args, *kwargs.items()))
            return kept(*args, **kwargs)

        called.cache_clear, called.cache_info = kept.cache_clear, kept.cache_info
        return called

    @contextmanager
    def _within(self, name: str) -> Iterator[None]:
        self.uses[self.stack[-1]].add(name)
        self._charge()
        self.stack.append(name)
        self.coverage.switch_context(name)
        try:
            yield
        finally:
            self._charge()
            self.stack.pop()
            self.coverage.switch_context(self.stack[-1])

    def _charge(self) -> None:
        """Charge what goes on with the time since the last charge."""
        now = time.process_time()
        self.cost[self.stack[-1]] += now - self.since
        self.since = now

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Charge a test with what it executes."""
        with self._within(item.nodeid):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        """Charge a shared fixture's lines to all that use it."""
        if fixturedef.scope == "function":
            return (yield)
        with self._within(_fixture(fixturedef)):
            return (yield)

    def pytest_runtest_call(self, item: pytest.Item) -> None:
        """Note which shared fixtures a test uses."""
        known = getattr(item, "_fixtureinfo", None)
        for definitions in getattr(known, "name2fixturedefs", {}).values():
            self.uses[item.nodeid].update(_fixture(x) for x in definitions)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test that fails or is skipped says nothing of a change."""
        if not report.passed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write what was seen."""
        self.coverage.stop()
        ran = {x for x in self.cost if x.startswith("tests/")}
        data, tests = self.coverage.get_data(), sorted(ran - self.failed)
        needs = {test: sorted(self._reached(test) - {test}) for test in tests}
        users = defaultdict(set)
        for test, shared in needs.items():
            for name in (test, *shared):
                users[name].add(test)
        lines = {}
        for file in data.measured_files():
            path, names = Path(file), places(Path(file).read_text())
            lines[path.relative_to(self.root).as_posix()] = {
                names[row - 1]: sorted(set().union(*(users.get(x, ()) for x in met)))
                for row, met in data.contexts_by_lineno(file).items()
                if 0 < row <= len(names)  # an empty module has no line
            }
        named = {*tests, *(x for shared in needs.values() for x in shared)}
        costs = {name: round(self.cost[name], 3) for name in named}
        Witnesses(costs, lines, self.files, needs).write(self.out)

    def _reached(self, name: str) -> set[str]:
        """A context, and all that were used within it."""
        found, open_ = {name}, [name]
        while open_:
            new = self.uses.get(open_.pop(), set()) - found
            found |= new
            open_ += new
        return found


def _fixture(definition: Any) -> str:
    return f"fixture {definition.baseid}::{definition.argname}"
