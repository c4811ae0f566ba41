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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from _pytest.main import pytest_runtestloop
from hypothesis import Phase
from mutation import ROOT, Mutant
from patch import Patch, patch_of
from recorder import Recorder
from witnesses import Witnesses, test_files

_COPIED = ("hybrid", "tests")
# Loaded before the fork, as they take longer than most tests.
_HEAVY = (
    "matplotlib.figure", "mujoco", "pinocchio", "scipy.linalg", "scipy.optimize",
    "scipy.signal", "scipy.spatial", "scipy.stats", "sklearn.cluster", "torch", "yaml",
)  # fmt: skip
_PATIENCE = 4.0  # times the processor time of the unchanged code, ended as "timeout"
_GRACE = 5.0  # s more
_WALL = 8.0  # times that limit in wall-clock time, for a process that sleeps
_BROKEN = 99
_OUTCOMES = {0: "survived", 1: "killed"}
Outcome = tuple[str, float, str]  # in a word, processor time [s], the test that fails


class Sandbox:
    """Runs tests against changed code; a context, at whose end the copy is gone."""

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
        self._clock = 0
        return self

    def __exit__(self, *_: Any) -> None:
        shutil.rmtree(self.root)

    def witnesses(self, file: Path) -> Witnesses:
        """What every test executes; test files that have changed are watched anew.

        Args:
            file: Keeps it, from one test file to the next.
        """
        known, part = Witnesses.read(file), self.root / "watched.json"
        for name, text in test_files().items():
            if known.files.get(name) == text:
                continue
            child = _fork()
            if child == 0:
                self._session([name], Recorder(self.root, {name: text}, part), ())
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            if status not in (0, 1, 5):  # all passed, some failed, or there are none
                raise SystemExit((self.root / "log").read_text()[-3000:])
            known = known.updated(Witnesses.read(part))
            known.write(file)
        return known

    def outcomes(
        self, mutants: Sequence[Mutant], witnesses: Witnesses
    ) -> Iterator[tuple[Mutant, Outcome]]:
        """What the tests say of each mutant, in any order."""
        inner, jobs, outer = [], [], []
        for mutant in mutants:
            tests = witnesses.of(mutant)
            limit = _PATIENCE * witnesses.price(tests) + _GRACE
            patch = patch_of((ROOT / mutant.path).read_text(), mutant)
            if not tests:
                yield mutant, ("survived", 0.0, "")
            elif patch is None:
                outer.append((mutant, Job(None, tests, limit)))
            else:
                inner.append(mutant)
                jobs.append(Job(patch, tests, limit))
        for k, outcome in self._forked(jobs, confirm=True):
            yield inner[k], outcome
        for mutant, job in outer:
            yield mutant, self._written(mutant, job)

    def _forked(self, jobs: list[Job], confirm: bool) -> Iterator[tuple[int, Outcome]]:
        """Outcomes of jobs, each in a fork of one session that has collected."""
        if not jobs:
            return
        inlet, outlet = os.pipe()
        child = _fork()
        if child == 0:
            os.close(inlet)
            files = sorted({x.partition("::")[0] for job in jobs for x in job.tests})
            self._session(files, _Forks(jobs, outlet, confirm))
        os.close(outlet)
        with os.fdopen(inlet) as lines:
            for k, line in enumerate(lines):
                yield k, tuple(json.loads(line))
        os.waitpid(child, 0)

    def _written(self, mutant: Mutant, job: Job) -> Outcome:
        """Outcome of a change that is written into the file.

        It is killed where the package cannot be loaded any more.
        """
        module = self.root / mutant.path
        before = module.read_text()
        self._write(module, mutant.source())
        try:
            found = self._forked([job], confirm=False)
            return next((x for _, x in found), ("killed", 0.0, "import"))
        finally:
            self._write(module, before)

    def _write(self, module: Path, source: str) -> None:
        """Write a module with a time of its own, or Python takes the old bytecode."""
        module.write_text(source)
        self._clock += 1
        os.utime(module, (self._clock, self._clock))

    def _session(
        self, files: Sequence[str], plugin: Any, stop: Sequence[str] = ("-x",)
    ) -> None:
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
            options = [*stop, "-q", "-s", "--tb=line"]
            options += [f"--basetemp={self.root}/temporary"]
            options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
            options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
            options += ["--hypothesis-profile=mutants", "--hypothesis-seed=0"]
            plugin.start()
            code = int(pytest.main([*options, *files], plugins=[plugin]))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)


@dataclass(frozen=True)
class Job:
    """A patch, none for the code as it is, and the tests that it meets.

    Attributes:
        patch: The patch.
        tests: Names of tests, in their order.
        limit: Processor time, ended as "timeout", [s].
    """

    patch: Patch | None
    tests: tuple[str, ...]
    limit: float


class _Forks:
    """A plugin that runs collected tests once for each job, in a fork.

    A test that fails must pass alone on the code as it is, and tests that run out of
    time must not do so there, or they say nothing.
    """

    def __init__(self, jobs: list[Job], outlet: int, confirm: bool) -> None:
        self.jobs, self.outlet, self.confirm = jobs, outlet, confirm
        self.unsound: set[str] = set()
        self.sound: set[str] = set()

    def start(self) -> None:
        """Nothing needs to be watched before tests are collected."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Run each job and say its outcome."""
        if session.testsfailed:
            return None
        for job in self.jobs:
            outcome = self._run(session, job)
            while again := self._again(session, job, outcome):
                job, outcome = again, self._run(session, again)
            os.write(self.outlet, (json.dumps(outcome) + "\n").encode())
        return True

    def _again(self, session: pytest.Session, job: Job, outcome: Outcome) -> Job | None:
        """What to try anew, where an outcome says nothing of the change."""
        word, _, test = outcome
        plain = replace(job, patch=None)
        if not self.confirm:
            return None
        if word == "timeout" and self._run(session, plain)[0] == "timeout":
            return replace(job, limit=2 * job.limit)
        if test and test not in self.sound | self.unsound:
            alone = self._run(session, replace(plain, tests=(test,)))
            (self.sound if alone[0] == "survived" else self.unsound).add(test)
        return job if test in self.unsound else None

    def _run(self, session: pytest.Session, job: Job) -> Outcome:
        """Outcome of a job, with the test that failed."""
        failed = Path.cwd() / "failed"
        failed.unlink(missing_ok=True)
        child = _fork()
        if child == 0:
            _limit(job.limit)
            _ended(session, job, self.unsound, failed)
        outcome, seconds = _waited(child, job.limit)
        return outcome, seconds, failed.read_text() if failed.exists() else ""


def _ended(session: pytest.Session, job: Job, unsound: set[str], out: Path) -> None:
    """Run a job's tests, write down the first that fails, and end the process."""
    code = _BROKEN
    try:
        if job.patch is not None:
            job.patch.apply()
        known = {x.nodeid: x for x in session.items}
        names = [x for x in job.tests if x in known and x not in unsound]
        session.items = [known[x] for x in names]
        session.config.pluginmanager.register(_First(out))
        try:
            pytest_runtestloop(session)
        except session.Failed:
            pass
        code = 1 if session.testsfailed else 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


class _First:
    """Writes down which test fails first."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that fails."""
        if report.failed and not self.out.exists():
            self.out.write_text(report.nodeid)


def _fork() -> int:
    sys.stdout.flush()
    return os.fork()


def _limit(seconds: float) -> None:
    """Give this process, with a group of its own, so much processor time, [s]."""
    os.setpgid(0, 0)
    whole = int(seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (whole, whole + 1))


def _waited(child: int, limit: float) -> tuple[str, float]:
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
        if seconds > 0.9 * limit or os.WTERMSIG(status) == signal.SIGXCPU:
            return "timeout", seconds
        # Of a process that got no processor, nothing is known.
        stalled = os.WTERMSIG(status) == signal.SIGKILL
        return "broken" if stalled else "killed", seconds
    return _OUTCOMES.get(os.waitstatus_to_exitcode(status), "broken"), seconds
