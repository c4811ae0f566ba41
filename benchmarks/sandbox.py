"""A copy of the tree in which a changed module meets its tests."""

from __future__ import annotations

import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hypothesis import Phase
from mutation import ROOT, SETTINGS, digest

_COPIED = ("hybrid", "tests")
# Loaded before the fork, as they take longer than most tests.
_HEAVY = (
    "matplotlib.figure", "mujoco", "pinocchio", "scipy.linalg",
    "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.stats", "sklearn.cluster",
    "torch", "yaml",
)  # fmt: skip
_LONG = 600.0  # s, for the unchanged code
_PATIENCE = 4.0  # times the processor time of the unchanged code, ended as "timeout"
_GRACE = 5.0  # s more, as one module's tests differ from another's
_WALL = 5.0  # times that limit in wall-clock time, for a process that sleeps
_BROKEN = 99
_OUTCOMES = {0: "survived", 1: "killed", 2: "killed", 3: "killed", 4: "killed"}


class _OwnTests:
    """Leaves out tests that are for another module of the folder by their parameter.

    A test of every effect need not run for all when one of them was changed.
    """

    def __init__(self, path: Path) -> None:
        self.own = path.stem
        self.names = {x.stem for x in path.parent.glob("*.py")}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what names no module, or the changed one."""
        named = [self.names & set(_parameters(x).split("-")) for x in items]
        if any(self.own in x for x in named):
            both = zip(items, named, strict=True)
            items[:] = [x for x, names in both if not names or self.own in names]


def _parameters(item: pytest.Item) -> str:
    """The text in brackets of a parametrised test's name."""
    return item.name.partition("[")[2].rstrip("]")


class Sandbox:
    """Runs tests against changed modules; a context, at whose end the copy is gone."""

    def __init__(self, file: Path) -> None:
        """Give the file that keeps how long the tests take on the unchanged code."""
        self._file = file

    def __enter__(self) -> Sandbox:
        for name in _HEAVY:
            importlib.import_module(name)
        # One example that fails is enough; a smaller one is of no interest.
        phases = (Phase.explicit, Phase.generate)
        hypothesis.settings.register_profile(
            "mutants", deadline=None, database=None, phases=phases
        )
        self.root = Path(tempfile.mkdtemp(prefix="mutants_"))
        for path in ROOT.iterdir():
            if path.name in _COPIED:
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(path, self.root / path.name, ignore=ignored)
            elif not path.name.startswith("."):
                (self.root / path.name).symlink_to(path)
        known = self._file.read_text() if self._file.exists() else "{}"
        self._baseline: dict[str, float] = json.loads(known)
        modules = sorted((self.root / "hybrid").rglob("*.py"))
        self._package = digest("".join(x.read_text() for x in modules))
        self._clock = 0
        return self

    def __exit__(self, *_: Any) -> None:
        shutil.rmtree(self.root)

    def tried(self, path: str, source: str) -> tuple[str, float]:
        """What the tests say of a changed module, and the processor time, [s].

        Args:
            path: The module, from the root of the tree.
            source: Its changed text.
        """
        tests = chosen_tests(path)
        limit = _PATIENCE * self._unchanged(path, tests)
        module = self.root / path
        before = module.read_text()
        self._write(module, source)
        try:
            outcome, seconds = self._run(path, tests, limit)
            if outcome == "broken":
                raise SystemExit((self.root / "log").read_text()[-3000:])
            return outcome, seconds
        finally:
            self._write(module, before)

    def _unchanged(self, path: str, tests: list[str]) -> float:
        """Processor time of tests that must pass on the code as it is, [s]."""
        key = self._package + self.digest(tests)
        if key not in self._baseline:
            outcome, seconds = self._run(path, tests, _LONG)
            if outcome != "survived":
                log = (self.root / "log").read_text()
                raise SystemExit(f"{tests} fail on the unchanged code:\n{log[-3000:]}")
            self._baseline[key] = seconds + _GRACE
            self._file.write_text(json.dumps(self._baseline))
        return self._baseline[key]

    def digest(self, tests: list[str]) -> str:
        """Short hash of some tests, and of what they share."""
        files = [*sorted((self.root / "tests").glob("[!t]*.py")), *tests]
        return digest("".join((self.root / x).read_text() for x in files))

    def _write(self, module: Path, source: str) -> None:
        """Write a module with a time of its own, or Python takes the old bytecode."""
        module.write_text(source)
        self._clock += 1
        os.utime(module, (self._clock, self._clock))

    def _run(self, path: str, tests: list[str], limit: float) -> tuple[str, float]:
        child = os.fork()
        if child == 0:
            try:
                os._exit(self._child(path, tests, limit))
            finally:
                traceback.print_exc()
                os._exit(_BROKEN)
        deadline = time.monotonic() + _WALL * limit
        while True:
            done, status, usage = os.wait4(child, os.WNOHANG)
            if done:
                break
            if time.monotonic() > deadline:
                os.killpg(child, signal.SIGKILL)
            time.sleep(0.02)
        seconds = usage.ru_utime + usage.ru_stime
        if os.WIFSIGNALED(status):
            by_time = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
            return "timeout" if by_time else "killed", seconds
        return _OUTCOMES.get(os.waitstatus_to_exitcode(status), "broken"), seconds

    def _child(self, path: str, tests: list[str], limit: float) -> int:
        """What pytest says of the copy."""
        os.setpgid(0, 0)
        seconds = int(limit) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        log = os.open(self.root / "log", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(self.root)
        for name in [x for x in sys.modules if x.split(".")[0] == "hybrid"]:
            del sys.modules[name]
        sys.path[:0] = [str(self.root), str(self.root / "tests")]
        os.environ["PYTHONPATH"] = str(self.root)
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # loaded before
        slow = [f"--deselect={x}" for x in SETTINGS["slow"]]
        options += [*slow, "--hypothesis-profile=mutants", "--hypothesis-seed=0"]
        options += ["--tb=no" if limit < _LONG else "--tb=short", *tests]
        return int(pytest.main(options, plugins=[_OwnTests(self.root / path)]))


def chosen_tests(path: str) -> list[str]:
    """Test files of a module: those named for it, or else for its folder."""
    names = [x for x in SETTINGS["tests"] if path.startswith(x)]
    found = SETTINGS["tests"][max(names, key=len)]
    return [f"tests/test_{x}.py" for x in found]
