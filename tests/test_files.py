"""Folders appear whole or not at all."""

import pytest

from hybrid.files import atomic_folder


def write_two(folder, *, fails: bool = False) -> None:
    with atomic_folder(folder) as hidden:
        (hidden / "a.txt").write_text("new a")
        if fails:
            raise KeyboardInterrupt
        (hidden / "b.txt").write_text("new b")


def content(folder) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_new_folder_holds_what_was_written(tmp_path):
    write_two(tmp_path / "deep" / "new")
    assert content(tmp_path / "deep" / "new") == {"a.txt": "new a", "b.txt": "new b"}
    assert [x.name for x in (tmp_path / "deep").iterdir()] == ["new"]


def test_a_folder_that_is_there_keeps_its_other_files(tmp_path):
    (tmp_path / "a.txt").write_text("old a")
    (tmp_path / "c.txt").write_text("old c")
    write_two(tmp_path)
    expected = {"a.txt": "new a", "b.txt": "new b", "c.txt": "old c"}
    assert content(tmp_path) == expected


def test_the_folder_may_be_the_one_one_is_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_two(".")
    assert set(content(tmp_path)) == {"a.txt", "b.txt"}


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
