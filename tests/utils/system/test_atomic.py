"""Files that appear whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE

import pytest

from embodichain.utils.system.atomic import atomic_file, remove_abandoned, write_text
from embodichain.utils.system.processes import own_process


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


KILLED = """
import os, sys
from pathlib import Path
from embodichain.utils.system.atomic import atomic_file, temporary_name

folder = Path(sys.argv[1])
(folder / temporary_name("data_set")).mkdir()
(folder / temporary_name("latest")).symlink_to("nowhere")
with atomic_file(folder / "film.mp4") as temporary:
    temporary.write_text("half")
    print("writing", flush=True)
    sys.stdin.readline()
    os.kill(os.getpid(), 9)
"""


def test_what_a_killed_process_left_is_removed_by_the_next_that_writes(folder: Path) -> None:
    users = [folder / name for name in (".notes.part", ".a.1-2-3.part.txt", "b.part.txt", ".c.txt")]
    for path in users:
        path.write_text("mine")
    command = [sys.executable, "-c", KILLED, str(folder)]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, text=True) as process:
        assert process.stdout is not None and process.stdin is not None
        process.stdout.readline()
        left = set(folder.iterdir()) - set(users)
        assert len(left) == 3 and all(path.name.startswith(".") for path in left)
        write_text(folder / "a.txt", "while it lives")
        assert left <= set(folder.iterdir())
        process.stdin.write("\n")
        process.stdin.close()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # dead, but not waited for
        write_text(folder / "a.txt", "after its end")
        assert set(folder.iterdir()) == {*users, folder / "a.txt"}
    assert {path.read_text() for path in users} == {"mine"}


def test_what_another_machine_or_an_earlier_boot_left_stays(folder: Path) -> None:
    """A process id says nothing there: the process may live."""
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    own = own_process()
    other = f"{int(own.place, 16) ^ 1:08x}"
    elsewhere = folder / f".a.{other}-{ended.pid}-{own.began}-1.part.txt"
    here = folder / f".a.{own.place}-{ended.pid}-{own.began}-1.part.txt"
    again = folder / f".a.{own.place}-{own.pid}-{own.began - 1}-1.part.txt"  # the id, used again
    for path in (elsewhere, here, again):
        path.write_text("half")
    remove_abandoned(folder)
    assert list(folder.iterdir()) == [elsewhere]


def test_an_error_names_the_file_and_not_its_temporary_name(folder: Path) -> None:
    with pytest.raises(OSError, match="No space left") as raised, atomic_file(folder / "a.txt"):
        raise OSError(28, "No space left on device")
    assert raised.value.filename == str(folder / "a.txt")
    with pytest.raises(FileNotFoundError) as raised:
        write_text(folder / "missing/a.txt", "text")
    assert raised.value.filename == str(folder / "missing/a.txt")


def test_an_error_of_the_disk_is_raised_where_a_library_hides_it(folder: Path) -> None:
    with pytest.raises(OSError, match="No space left") as raised, atomic_file(folder / "a.zip"):
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        finally:
            raise RuntimeError("unexpected pos")
    assert raised.value.filename == str(folder / "a.zip")
    with pytest.raises(RuntimeError), atomic_file(folder / "a.zip"):
        try:
            raise FileNotFoundError(errno.ENOENT, "looked for, and not there")
        except FileNotFoundError:
            raise RuntimeError("another mistake")  # noqa: B904  (as a library does)
    assert list(folder.iterdir()) == []
