"""A copy of the tree in which changed code meets its tests.

Tests are collected once for many mutants. Each then has a process of its own, forked
from there, in which the one function that was changed is given its other code. What
lies outside functions, such as a constant, is written into the file, and all is loaded
anew.
"""

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
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hypothesis import Phase
from mutation import ROOT, Mutant, digest
from patch import Patch, patch_of
from tiers import Tier, tiers

_COPIED = ("hybrid", "tests")
# Loaded before the fork, as they take longer than most tests.
_HEAVY = (
    "matplotlib.figure", "mujoco", "pinocchio", "scipy.linalg", "scipy.optimize",
    "scipy.signal", "scipy.spatial", "scipy.stats", "sklearn.cluster", "torch", "yaml",
)  # fmt: skip
_LONG = 600.0  # s, for the unchanged code
_PATIENCE = 4.0  # times the processor time of the unchanged code, ended as "timeout"
_GRACE = 5.0  # s more
_WALL = 8.0  # times that limit in wall-clock time, for a process that sleeps
_BROKEN = 99
# Five: no test is left, as none of the folder is slow or beside. Else none ran.
_OUTCOMES = {0: "survived", 1: "killed", 2: "killed", 5: "survived"}
Outcome = tuple[str, float]  # in a word, and processor time, [s]


class Sandbox:
    """Runs tests against changed code; a context, at whose end the copy is gone.

    Args:
        file: Keeps how long the tests take on the unchanged code.
    """

    def __init__(self, file: Path) -> None:
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

    def outcomes(self, mutants: Sequence[Mutant]) -> Iterator[tuple[Mutant, Outcome]]:
        """What the tests say of each mutant, in any order."""
        groups: dict[tuple[Tier, Tier], list[Mutant]] = {}
        for mutant in mutants:
            groups.setdefault(tiers(mutant.path), []).append(mutant)
        for (first, second), group in groups.items():
            left: dict[Mutant, float] = {}
            for mutant, (outcome, seconds) in self._met(group, first):
                if outcome == "survived":
                    left[mutant] = seconds
                else:
                    yield mutant, (outcome, seconds)
            for mutant, (outcome, seconds) in self._met(list(left), second):
                yield mutant, (outcome, left[mutant] + seconds)

    def _met(self, group: list[Mutant], tier: Tier) -> Iterator[tuple[Mutant, Outcome]]:
        """What one tier of tests says of each mutant."""
        if not group:
            return
        limit = _PATIENCE * self._unchanged(tier) + _GRACE
        patches = {m: patch_of((ROOT / m.path).read_text(), m) for m in group}
        inner = [(m, p) for m, p in patches.items() if p is not None]
        for k, outcome in self._forked(tier, [p for _, p in inner], limit):
            yield inner[k][0], outcome
        for mutant in group:
            if patches[mutant] is None:
                yield mutant, self._written(mutant, tier, limit)

    def _unchanged(self, tier: Tier) -> float:
        """Processor time of tests that must pass on the code as it is, [s]."""
        key = self._package + tier.digest
        if key not in self._baseline:
            ((_, (outcome, seconds)),) = self._forked(tier, [None], _LONG)
            if outcome != "survived":
                log = (self.root / "log").read_text()
                raise SystemExit(
                    f"{tier.files} fail on the unchanged code:\n{log[-3000:]}"
                )
            self._baseline[key] = seconds
            self._file.write_text(json.dumps(self._baseline))
        return self._baseline[key]

    def _forked(
        self, tier: Tier, patches: list[Patch | None], limit: float
    ) -> Iterator[tuple[int, Outcome]]:
        """Outcomes of patches, each in a fork of one session that has collected."""
        if not patches:
            return
        inlet, outlet = os.pipe()
        child = _fork()
        if child == 0:
            os.close(inlet)
            self._session(tier, [_Forks(patches, limit, outlet)])
        os.close(outlet)
        with os.fdopen(inlet) as lines:
            for k, line in enumerate(lines):
                yield k, tuple(json.loads(line))
        os.waitpid(child, 0)

    def _written(self, mutant: Mutant, tier: Tier, limit: float) -> Outcome:
        """Outcome of a change that is written into the file."""
        module = self.root / mutant.path
        before = module.read_text()
        self._write(module, mutant.source())
        child = _fork()
        if child == 0:
            _limit(limit)
            self._session(tier, [_Own(mutant.path)])
        try:
            return _waited(child, limit)
        finally:
            self._write(module, before)

    def _write(self, module: Path, source: str) -> None:
        """Write a module with a time of its own, or Python takes the old bytecode."""
        module.write_text(source)
        self._clock += 1
        os.utime(module, (self._clock, self._clock))

    def _session(self, tier: Tier, plugins: list[Any]) -> None:
        """Run pytest on the copy, and end the process."""
        code = _BROKEN
        try:
            log = os.open(self.root / "log", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.chdir(self.root)
            for name in [x for x in sys.modules if x.split(".")[0] == "hybrid"]:
                del sys.modules[name]
            sys.path[:0] = [str(self.root), str(self.root / "tests")]
            os.environ["PYTHONPATH"] = str(self.root)
            options = ["-x", "-q", "-s", "--tb=line"]
            options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
            options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
            options += ["--hypothesis-profile=mutants", "--hypothesis-seed=0"]
            plugins = [tier, *plugins]
            code = int(pytest.main([*options, *tier.files], plugins=plugins))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)


class _Forks:
    """A plugin that runs the collected tests once for each patch, in a fork."""

    def __init__(self, patches: list[Patch | None], limit: float, outlet: int) -> None:
        self.patches, self.limit, self.outlet = patches, limit, outlet

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Fork for each patch; the child goes on with the usual loop."""
        if session.testsfailed:
            return None
        for patch in self.patches:
            child = _fork()
            if child == 0:
                _limit(self.limit)
                if patch is not None:
                    _applied(patch)
                    _Own(patch.path).pytest_collection_modifyitems(session.items)
                return None
            line = json.dumps(_waited(child, self.limit)) + "\n"
            os.write(self.outlet, line.encode())
        return True


class _Own:
    """Leaves out tests that are for another module of the folder by their parameter.

    A test of every effect need not run for all when one of them was changed.
    """

    def __init__(self, path: str) -> None:
        self.own = Path(path).stem
        self.names = {x.stem for x in Path(path).parent.glob("*.py")}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what names no module, or the changed one."""
        named = [self.names & set(_parameters(x).split("-")) for x in items]
        if any(self.own in x for x in named):
            both = zip(items, named, strict=True)
            items[:] = [x for x, names in both if not names or self.own in names]


def _parameters(item: pytest.Item) -> str:
    """The text in brackets of a parametrised test's name."""
    return item.name.partition("[")[2].rstrip("]")


def _applied(patch: Patch) -> None:
    try:
        patch.apply()
    except Exception:
        traceback.print_exc()
        os._exit(_BROKEN)


def _fork() -> int:
    sys.stdout.flush()
    return os.fork()


def _limit(seconds: float) -> None:
    """Give this process, with a group of its own, so much processor time, [s]."""
    os.setpgid(0, 0)
    whole = int(seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (whole, whole + 1))


def _waited(child: int, limit: float) -> Outcome:
    """Wait for a process that was given a limit, [s]."""
    deadline = time.monotonic() + _WALL * limit
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.01)
    seconds = usage.ru_utime + usage.ru_stime
    if os.WIFSIGNALED(status):
        if seconds > 0.9 * limit:
            return "timeout", seconds
        # Of a process that got no processor, nothing is known.
        stalled = os.WTERMSIG(status) == signal.SIGKILL
        return "broken" if stalled else "killed", seconds
    return _OUTCOMES.get(os.waitstatus_to_exitcode(status), "broken"), seconds
