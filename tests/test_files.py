"""Folders and files appear whole or not at all, whoever writes and whatever stops."""

import json
import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hybrid import files
from hybrid.errors import HybridError
from hybrid.files import (
    atomic_folder,
    atomic_path,
    read_json,
    read_yaml,
    write_json,
)
from hybrid.plant.simulate import write_run
from hybrid.recording import Recording, read_all

needs_fork = pytest.mark.skipif(
    not hasattr(os, "fork") or sys.platform == "win32", reason="needs POSIX"
)


def write_two(folder, *, fails: bool = False, text: str = "new") -> None:
    with atomic_folder(folder) as hidden:
        (hidden / "a.txt").write_text(f"{text} a")
        if fails:
            raise KeyboardInterrupt
        (hidden / "b.txt").write_text(f"{text} b")


def content(folder) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_new_folder_holds_what_was_written(tmp_path):
    write_two(tmp_path / "deep" / "new")
    assert content(tmp_path / "deep" / "new") == {"a.txt": "new a", "b.txt": "new b"}
    assert [x.name for x in (tmp_path / "deep").iterdir()] == ["new"]


def test_a_folder_that_is_there_keeps_its_other_files_and_its_mode(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir(mode=0o750)
    (folder / "a.txt").write_text("old a")
    (folder / "c.txt").write_text("old c")
    (folder / "link").symlink_to("c.txt")
    write_two(folder)
    expected = {"a.txt": "new a", "b.txt": "new b", "c.txt": "old c", "link": "old c"}
    assert content(folder) == expected
    assert (folder / "link").is_symlink()
    assert folder.stat().st_mode & 0o777 == 0o750
    assert [x.name for x in tmp_path.iterdir()] == ["out"]


def test_the_folder_may_be_the_one_one_is_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = os.stat(".").st_ino
    write_two(".")
    assert set(content(tmp_path)) == {"a.txt", "b.txt"}
    assert os.stat(tmp_path).st_ino == here  # who stands in it, stays in it


def test_a_folder_with_folders_in_it_keeps_them(tmp_path):
    (tmp_path / "out" / "mine").mkdir(parents=True)
    (tmp_path / "out" / "mine" / "x.txt").write_text("x")
    write_two(tmp_path / "out")
    assert (tmp_path / "out" / "mine" / "x.txt").read_text() == "x"
    assert {x.name for x in (tmp_path / "out").iterdir()} == {"a.txt", "b.txt", "mine"}


def test_a_device_or_a_pipe_is_never_replaced(tmp_path):
    """As /dev/null and /dev/stdout, which root could rename a file over."""
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(OSError, match="is a device or pipe; valid is the name"):
            write_json(path, {})
    assert pipe.is_fifo() and link.is_symlink()
    assert {x.name for x in tmp_path.iterdir()} == {"pipe", "link"}


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "here.json").symlink_to("there.json")
    write_json(tmp_path / "here.json", {"a": 1})
    assert (tmp_path / "here.json").is_symlink()
    assert read_json(tmp_path / "there.json") == {"a": 1}


@pytest.mark.parametrize("is_new", [True, False])
def test_an_interrupt_leaves_what_was_there(tmp_path, is_new):
    folder = tmp_path / "out"
    if not is_new:
        folder.mkdir()
        (folder / "a.txt").write_text("old a")
    with pytest.raises(KeyboardInterrupt):
        write_two(folder, fails=True)
    if is_new:
        assert list(tmp_path.iterdir()) == []
    else:
        assert content(folder) == {"a.txt": "old a"}


def test_where_folders_cannot_be_exchanged_one_is_put_aside(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_exchanged", lambda one, other: False)
    for text in ("old", "new"):
        write_two(tmp_path / "out", text=text)
    assert content(tmp_path / "out") == {"a.txt": "new a", "b.txt": "new b"}
    assert [x.name for x in tmp_path.iterdir()] == ["out"]


# --- kill -9 --------------------------------------------------------------------------

STEPS = ("replace", "rename", "fsync", "link", "unlink")


def killed_at(step: int, work) -> bool:
    """Run in a process that dies before its step-th change of the disk; if it did."""
    child = os.fork()
    if child == 0:
        count = 0

        def dying(function):
            def change(*given, **options):
                nonlocal count
                if count == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                count += 1
                return function(*given, **options)

            return change

        try:
            for name in STEPS:
                setattr(os, name, dying(getattr(os, name)))
            files._exchanged = dying(files._exchanged)
            work()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


@needs_fork
@pytest.mark.parametrize("is_new", [True, False])
def test_killed_at_any_step_a_folder_is_old_or_new(tmp_path, is_new):
    folder, seen = tmp_path / "out", []
    for step in range(100):
        if is_new:
            folder = tmp_path / f"out_{step}"
        else:
            write_two(folder, text="old")
        died = killed_at(step, lambda folder=folder: write_two(folder))
        found = content(folder) if folder.exists() else {}
        old = {} if is_new else {"a.txt": "old a", "b.txt": "old b"}
        assert found in (old, {"a.txt": "new a", "b.txt": "new b"})
        seen.append(found != old)
        if not died:
            break
    assert step >= 5 and seen[-1] and not seen[0]


@needs_fork
def test_killed_at_any_step_a_simulation_is_old_or_new(tmp_path):
    """Its recordings and its truth are of one run, and load."""
    t = np.linspace(0.0, 1.0, 50)
    runs = {
        text: [Recording(t, k + size * np.outer(t, [1.0, 2.0])) for k in range(2)]
        for text, size in (("old", 1.0), ("new", 2.0))
    }
    for step in range(100):
        write_run(tmp_path / "logs", runs["old"], {"of": "old"})
        died = killed_at(
            step, lambda: write_run(tmp_path / "logs", runs["new"], {"of": "new"})
        )
        logs = read_all(tmp_path / "logs", torque=False)
        assert logs == runs[read_json(tmp_path / "logs" / "truth.json")["of"]]
        if not died:
            break
    assert step >= 8


@needs_fork
def test_killed_at_any_step_a_file_is_old_or_new(tmp_path):
    path = tmp_path / "x.json"
    for step in range(100):
        write_json(path, "old")
        died = killed_at(step, lambda: write_json(path, "new"))
        assert read_json(path) in ("old", "new")
        if not died:
            break
    assert step >= 3 and read_json(path) == "new"


# --- many at once ---------------------------------------------------------------------


@needs_fork
def test_readers_among_ten_writers_see_no_mixture(tmp_path):
    folder, path = tmp_path / "out", tmp_path / "x.json"
    write_two(folder, text="first")
    write_json(path, ["first"] * 1000)
    children = []
    for name in range(10):
        child = os.fork()
        if child == 0:
            try:
                for k in range(15):
                    with atomic_folder(folder) as hidden:
                        for letter in "ab":
                            text = f"{name}.{k} {letter}"
                            (hidden / f"{letter}.txt").write_text(text)
                        (hidden / f"own_{name}.txt").write_text(str(k))
                    write_json(path, [f"{name}.{k}"] * 1000)
            except BaseException:
                os._exit(1)
            os._exit(0)
        children.append(child)
    reads, done = 0, threading.Event()
    status = []

    def wait():
        status.extend(os.waitpid(child, 0)[1] for child in children)
        done.set()

    threading.Thread(target=wait).start()
    while not done.is_set():
        assert len(set(read_json(path))) == 1
        descriptor = os.open(folder, os.O_RDONLY)  # one folder, whatever its name does
        pair = [_read_at(descriptor, f"{letter}.txt") for letter in "ab"]
        os.close(descriptor)
        if None not in pair:  # else it was replaced and removed while it was read
            assert pair[0].split()[0] == pair[1].split()[0]
        reads += 1
        time.sleep(0.001)
    assert status == [0] * 10 and reads > 10
    found = content(folder)  # nobody's own file was lost on the way
    assert {f"own_{k}.txt" for k in range(10)} <= set(found)
    assert {x.name for x in tmp_path.iterdir()} == {"out", "x.json"}


def _read_at(folder: int, name: str) -> str | None:
    try:
        with open(os.open(name, os.O_RDONLY, dir_fd=folder)) as file:
            return file.read()
    except FileNotFoundError:
        return None


# --- a full disk ----------------------------------------------------------------------


@needs_fork
@pytest.mark.parametrize("room", [0, 100, 5000])
def test_a_full_disk_leaves_what_was_there(tmp_path, room):
    folder, path = tmp_path / "out", tmp_path / "x.json"
    write_two(folder, text="old")
    write_json(path, "old")
    child = os.fork()
    if child == 0:
        failures = 0
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        try:
            write_json(path, "new" * 10_000)
        except OSError as error:
            failures += error.filename == str(path)  # not what stands in for it
        try:
            write_two(folder, text="new" * 10_000)
        except OSError:
            failures += 1
        os._exit(failures)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 2
    assert read_json(path) == "old"
    assert content(folder) == {"a.txt": "old a", "b.txt": "old b"}
    assert {x.name for x in tmp_path.iterdir()} == {"out", "x.json"}


# --- what is read ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 40 + "]" * 40, "nested deeper"),
        ("[" * 100_000, "nested deeper"),
        ("[NaN]", "NaN is not a number of JSON"),
        ("[-Infinity]", "-Infinity is not"),
        ("{", "Expecting property name"),
    ],
)
def test_json_beyond_measure_is_refused(tmp_path, text, words):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(ValueError, match=words):
        read_json(tmp_path / "x.json")


def test_json_comes_back(tmp_path):
    given = {"a": [1, 2.5, None, True, "é"], "b": {"c": []}}
    write_json(tmp_path / "x.json", given)
    assert read_json(tmp_path / "x.json") == given
    assert json.loads(Path(tmp_path / "x.json").read_text("utf-8")) == given


def test_a_path_is_written_beside_and_moved(tmp_path):
    with atomic_path(tmp_path / "x.csv") as temporary:
        temporary.write_text("x")
        assert temporary.suffix == ".csv" and temporary.parent == tmp_path
        assert not (tmp_path / "x.csv").exists()
    assert [x.name for x in tmp_path.iterdir()] == ["x.csv"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 40 + "]" * 40, "more than 32 levels"),
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "has references"),
        (
            "a: !!python/object/apply:os.getcwd []\n",
            "determine a constructor",
        ),
        ("q: 1\nv: 2\nq: 3", "has the key 'q' twice; valid is once"),
        ("a: [{b: 1, b: 1}]", "has the key 'b' twice"),
        ("x" * 200_000, "bytes; valid are up to"),
        ("a: [", "while parsing"),
    ],
)
def test_yaml_beyond_measure_is_refused(tmp_path, text, words):
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(HybridError, match=words) as error:
        read_yaml(tmp_path / "x.yaml")
    assert "\n" not in str(error.value)
