"""Files that appear whole or not at all."""

from pathlib import Path

import pytest

from embodichain.utils.atomic import atomic_file, write_text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder."""
    path = tmp_path / "empty"
    path.mkdir()
    return path


def test_a_failed_write_leaves_the_old_file_and_nothing_else(folder: Path) -> None:
    path = folder / "a.txt"
    write_text(path, "old")
    with pytest.raises(ZeroDivisionError), atomic_file(path) as temporary:
        temporary.write_text("new")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert list(folder.iterdir()) == [path]


def test_the_name_is_the_old_file_until_the_new_one_is_whole(folder: Path) -> None:
    path = folder / "picture.png"
    write_text(path, "old")
    with atomic_file(path) as temporary:
        assert temporary.suffix == ".png"  # writers choose their format by it
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(folder.iterdir()) == [path]


def test_a_new_file_replaces_none(folder: Path) -> None:
    path = folder / "a.txt"
    write_text(path, "first", new=True)
    with pytest.raises(FileExistsError):
        write_text(path, "second", new=True)
    assert path.read_text() == "first"
    assert list(folder.iterdir()) == [path]


def test_a_writer_that_writes_nothing_is_an_error(folder: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_file(folder / "a.txt"):
        pass
    assert list(folder.iterdir()) == []
