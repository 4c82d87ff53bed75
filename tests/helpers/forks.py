"""A process that forks commands, of which the n-th call on a file fails (`nth_call.c`).

The process has imported everything, so that a try costs no imports. It runs with the library
preloaded; each command is a fork of it, in which the n-th call on files below a folder fails.
"""

from __future__ import annotations

import ctypes
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from tests.helpers.forking import (
    import_again,
    import_first,
    imported_since,
    open_stdout_and_stderr,
)

__all__ = ["Ended", "Forks", "verb_forks"]

SOURCE = Path(__file__).with_name("nth_call.c")
_EXTRAS = (
    "embodichain.recording.export.episode_formats.lerobot",
    "embodichain.recording.export.episode_formats.robomimic",
    "embodichain.recording.export.formats.ros2",
    "embodichain.recording.export.formats.parquet",
    "h5py",
    "pandas",
    "pyarrow.parquet",
    "rosbags.typesys",
)
"""What commands with packages of extras import."""


def _build(folder: Path) -> Path:
    """Build the library in a folder, and return its path.

    Raises:
        FileNotFoundError: There is no gcc.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        raise FileNotFoundError("there is no gcc, which builds what makes calls fail")
    path = folder / "nth_call.so"
    command = [gcc, "-O1", "-shared", "-fPIC", "-o", str(path), str(SOURCE), "-ldl"]
    subprocess.run(command, check=True)
    return path


@dataclass(frozen=True)
class Ended:
    """A command that has ended.

    Attributes:
        code: Its exit code; negative for a signal.
        err: What it wrote to stderr.
        calls: The calls that were counted, each with its file.
        failed: The call that failed, and its file; empty if none did.
    """

    code: int
    err: str
    calls: list[str]
    failed: str


class Forks:
    """Runs commands, each in a fork of a process that has imported everything.

    Args:
        library: `nth_call.c`, built.
    """

    def __init__(self, library: Path) -> None:
        environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONFAULTHANDLER": "1"}
        environment |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        stdin = self._process.stdin
        if stdin is not None:
            stdin.close()
        self._process.wait()

    def run(
        self,
        arguments: Sequence[str],
        below: Path,
        n: int = 0,
        number: int = errno.EIO,
        *,
        stays: bool = False,
        kill_after: float | None = None,
    ) -> Ended:
        """Run a command, and wait for its end.

        Args:
            arguments: After ``embodichain``.
            below: The folder whose files are counted; also the working directory.
            n: The call that fails, from 1; 0 is none.
            number: The error's number.
            stays: Whether all later calls that write fail too, as on a full disk.
            kill_after: Seconds after which it is killed (SIGKILL), unless it has ended.
        """
        pid = self.start(arguments, below, n, number, stays=stays)
        return self.wait(pid, kill_after)

    def start(
        self,
        arguments: Sequence[str],
        below: Path,
        n: int = 0,
        number: int = errno.EIO,
        *,
        stays: bool = False,
    ) -> int:
        """Start a command, and return its process id; the arguments are those of `run`."""
        request = {"arguments": [*arguments], "below": str(below), "n": n, "number": number}
        pid: int = self._answer({**request, "stays": stays})
        return pid

    def wait(self, pid: int, kill_after: float | None = None) -> Ended:
        """Wait for the end of a command that was started.

        Args:
            pid: Its process id.
            kill_after: Seconds after which it is killed (SIGKILL), unless it has ended.
        """
        return Ended(**self._answer({"pid": pid, "kill_after": kill_after}))

    def warm(self, arguments: Sequence[str]) -> None:
        """Run a command in the process itself, so that the forks have what it keeps in memory.

        Args:
            arguments: After ``embodichain``. It must start no thread, since a fork has none.
        """
        self._answer({"warm": [*arguments]})

    def _answer(self, request: dict[str, Any]) -> Any:
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("no pipes")
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the process that forks has ended: {process.wait()}")
        return json.loads(answer)


@contextmanager
def verb_forks(place: Path) -> Iterator[Forks]:
    """Build the library in a folder, and start the process that forks.

    Raises:
        FileNotFoundError: There is no gcc.
    """
    with Forks(_build(place)) as forks:
        yield forks


@dataclass
class _Fork:
    """What a command writes.

    Attributes:
        err: Its stdout and stderr.
        told: What it tells at its end, in JSON.
    """

    err: IO[bytes]
    told: IO[bytes]


def _serve() -> None:
    """Answer requests until there are no more."""
    from contextlib import redirect_stdout

    from embodichain.cli.app import main

    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    import_first()
    import_again(_EXTRAS)
    running: dict[int, _Fork] = {}
    for line in sys.stdin:
        request = json.loads(line)
        answer: object = None
        if "warm" in request:
            with redirect_stdout(io.StringIO()):
                main(request["warm"])
        elif "pid" in request:
            pid = request["pid"]
            answer = _ended(pid, running.pop(pid), request["kill_after"])
        else:
            fork = _Fork(_file(), _file())
            answer = os.fork()
            if not answer:
                _child(request, fork)
            running[answer] = fork
        out.write(json.dumps(answer) + "\n")
        out.flush()


def _file() -> IO[bytes]:
    """A file without a name, closed by `_ended`."""
    return os.fdopen(os.memfd_create("fork"), "w+b", buffering=0)


def _ended(pid: int, fork: _Fork, kill_after: float | None) -> dict[str, Any]:
    """Wait for a fork; import what it imported, so that no other has to."""
    code = os.waitstatus_to_exitcode(_waited(pid, kill_after))
    with fork.err, fork.told:
        fork.err.seek(0)
        fork.told.seek(0)
        told = json.loads(fork.told.read() or b'{"calls": [], "failed": "", "imported": []}')
        import_again(told.pop("imported"))
        return {"code": code, "err": fork.err.read().decode(errors="replace"), **told}


def _waited(pid: int, kill_after: float | None) -> int:
    """Wait for a fork, and kill it if it takes longer; returns how it ended."""
    if kill_after is not None:
        end = time.monotonic() + kill_after
        while time.monotonic() < end:
            if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None:
                break
            time.sleep(0.005)
        else:
            os.kill(pid, signal.SIGKILL)
    return os.waitpid(pid, 0)[1]


def _child(request: dict[str, Any], fork: _Fork) -> None:
    """Run a command in a fork, and end it."""
    from embodichain.cli.app import main

    code = 99
    before = set(sys.modules)
    try:
        os.dup2(fork.err.fileno(), 1)
        os.dup2(fork.err.fileno(), 2)
        open_stdout_and_stderr()
        below = request["below"]
        os.chdir(below)
        library: Any = ctypes.CDLL(None)
        library.nth_failed.restype = library.nth_list.restype = ctypes.c_char_p
        library.nth_arm(below.encode(), request["n"], request["number"], int(request["stays"]))
        code = main(request["arguments"])
        sys.stdout.flush()
        sys.stderr.flush()
        told = {
            "calls": library.nth_list().decode().splitlines(),
            "failed": library.nth_failed().decode(),
            "imported": imported_since(before),
        }
        os.write(fork.told.fileno(), json.dumps(told).encode())
    finally:
        os._exit(code)


if __name__ == "__main__":
    _serve()
