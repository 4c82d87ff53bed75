"""`embodichain ARGUMENTS` in processes of their own that do not import everything anew.

One process has imported what the verbs need, two seconds of CPU time, and has checked a config;
each command is a fork of it: with its own pid, pipes, working directory and signals, and an exit as
any interpreter's, except that it does not take apart what it shares. What is about the start itself
(imports, encodings, variables that libraries read) needs a real ``python -m embodichain``.
"""

from __future__ import annotations

import atexit
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from tests.helpers.forking import (
    import_again,
    import_first,
    imported_since,
    open_stdout_and_stderr,
)

__all__ = ["Command", "Commands", "commands", "cpu_seconds"]

_ROOT = Path(__file__).parents[2]
_LONGEST = 1 << 17
"""Bytes of a request."""


_cpu_seconds: list[float] = []
"""Of the commands that have ended, until the process that forks is waited for."""


def cpu_seconds() -> float:
    """Return the CPU time of commands that this process' own `os.times` does not contain yet."""
    return sum(_cpu_seconds)


class Command:
    """A command that was started; its methods are those of `subprocess.Popen`.

    Attributes:
        args: The command, as it is typed.
        pid: Of its process.
        returncode: None until it was seen to have ended; negative for a signal.
        stdout: What it prints.
        stderr: What it prints there.
    """

    def __init__(
        self, arguments: tuple[str, ...], connection: socket.socket, stdout: int, stderr: int
    ) -> None:
        self.args = ("embodichain", *arguments)
        self.returncode: int | None = None
        self.stdout: IO[str] = os.fdopen(stdout, encoding="utf-8")
        self.stderr: IO[str] = os.fdopen(stderr, encoding="utf-8")
        self.pid = int(connection.recv(64))
        self._connection = connection

    def poll(self) -> int | None:
        """Return the exit code, None if it has not ended."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end, and return the exit code."""
        if self.returncode is None:
            if not select.select([self._connection], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            code, seconds = self._connection.recv(64).split()
            self._connection.close()
            _cpu_seconds.append(float(seconds))
            self.returncode = int(code)
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for its end, and return what it printed and was not read yet."""
        end = None if timeout is None else time.monotonic() + timeout
        texts = ["", ""]

        def read(number: int, stream: IO[str]) -> None:
            with stream:
                texts[number] = stream.read()

        streams = (self.stdout, self.stderr)
        readers = [
            threading.Thread(target=read, args=pair, daemon=True) for pair in enumerate(streams)
        ]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(None if end is None else max(0.0, end - time.monotonic()))
            if reader.is_alive():
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        self.wait(None if end is None else max(0.0, end - time.monotonic()))
        return texts[0], texts[1]

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL, unless it has ended."""
        self.send_signal(signal.SIGKILL)


class Commands:
    """Starts commands.

    Args:
        address: Of the process that forks.
    """

    def __init__(self, address: str) -> None:
        self._address = address

    def start(self, *arguments: str, cwd: Path | None = None) -> Command:
        """Start a command, with this process' environment variables.

        Args:
            arguments: After ``embodichain``.
            cwd: Its working directory; None is the current one.
        """
        request = {"arguments": arguments, "cwd": str(cwd or Path.cwd()), "env": dict(os.environ)}
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.connect(self._address)
        out, out_end = os.pipe()
        err, err_end = os.pipe()
        socket.send_fds(connection, [json.dumps(request).encode()], [out_end, err_end])
        os.close(out_end)
        os.close(err_end)
        return Command(arguments, connection, out, err)

    def run(
        self, *arguments: str, cwd: Path | None = None, timeout: float = 120.0
    ) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, as `subprocess.run` with captured output."""
        command = self.start(*arguments, cwd=cwd)
        try:
            out, err = command.communicate(timeout)
        finally:
            command.kill()
        return subprocess.CompletedProcess(command.args, command.wait(), out, err)


@contextmanager
def commands() -> Iterator[Commands]:
    """Provide commands while the context lasts."""
    with tempfile.TemporaryDirectory() as folder:
        address = f"{folder}/commands"
        server = subprocess.Popen(
            [sys.executable, "-m", __name__, address],
            cwd=_ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        with server:
            if server.stdin is None or server.stdout is None:
                raise RuntimeError("no pipes")
            if not server.stdout.readline():
                raise RuntimeError(f"the process that forks has ended: {server.wait()}")
            yield Commands(address)
            server.stdin.close()
        _cpu_seconds.clear()


# -- the process that forks ------------------------------------------------------------------------


def _serve(address: str) -> bool:
    """Fork commands until stdin is closed; returns whether this process is such a fork."""
    import_first()
    _check_a_config()
    folder = Path(address).parent
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address)
        listener.listen()
        print("ready", flush=True)
        while sys.stdin not in (ready := select.select([sys.stdin, listener], [], [])[0]):
            connection, _ = ready[0].accept()
            request, pipes, _, _ = socket.recv_fds(connection, _LONGEST, 2)
            for note in folder.glob("*.json"):
                import_again(json.loads(note.read_text()))
                note.unlink()
            keeper = os.fork()
            if not keeper:
                listener.close()
                if _forked(connection, *pipes):
                    _become(json.loads(request))
                    atexit.register(_note_imports, folder, os.getpid(), set(sys.modules))
                    return True
            for descriptor in (connection.detach(), *pipes):
                os.close(descriptor)
            with suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
    return False


def _forked(connection: socket.socket, out: int, err: int) -> bool:
    """Fork the command, in which True is returned; the process between waits and tells its end."""
    pid = os.fork()
    if not pid:
        connection.close()
        for descriptor, number in ((out, 1), (err, 2), (os.open(os.devnull, os.O_RDONLY), 0)):
            os.dup2(descriptor, number)
            os.close(descriptor)
        return True
    os.close(out)
    os.close(err)
    with suppress(BrokenPipeError):  # nobody waits
        connection.send(str(pid).encode())
        _, status, usage = os.wait4(pid, 0)
        seconds = usage.ru_utime + usage.ru_stime
        connection.send(f"{os.waitstatus_to_exitcode(status)} {seconds}".encode())
    os._exit(0)


def _become(request: Mapping[str, object]) -> None:
    """Make this process what `python -m embodichain` begins with."""
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    open_stdout_and_stderr()
    os.environ.clear()
    os.environ.update(request["env"])  # type: ignore[call-overload]
    if "COVERAGE_PROCESS_CONFIG" not in os.environ:  # of a test that is marked `unmeasured`
        sys.settrace(None)
        threading.settrace(None)
    os.chdir(str(request["cwd"]))
    sys.path[0] = str(request["cwd"])
    sys.argv[1:] = list(request["arguments"])  # type: ignore[call-overload]


def _note_imports(folder: Path, pid: int, before: set[str]) -> None:
    """Write what the command has imported, for the process that forks."""
    if os.getpid() != pid or not folder.is_dir():
        return  # a process that the command has forked; or nobody forks any more
    part = folder / f"{pid}.part"
    part.write_text(json.dumps(imported_since(before)))
    part.rename(folder / f"{pid}.json")


def _check_a_config() -> None:
    """Check a config, so that the types of all keys, half a second of CPU time, are built once."""
    from embodichain.config import compose, validate

    problems = validate(compose(["task=reach"]))
    if problems:
        raise RuntimeError(f"a config that ships has mistakes: {problems}")


def _run_command() -> None:
    """Run the command, and end this process as an interpreter ends, but at once.

    An interpreter takes every module apart at its end. A fork would copy the pages of what it
    shares for that: 0.25 s of CPU time, more than many commands take.
    """
    code: object = 0
    try:
        runpy.run_module("embodichain", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code
    is_number = code is None or isinstance(code, int)
    if not is_number or "COVERAGE_PROCESS_CONFIG" in os.environ:  # coverage writes at the very end
        sys.exit(code)  # type: ignore[arg-type]
    # What an interpreter does first at its end, in this order; nothing public does it.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):  # nobody reads: the interpreter has an exit code for it
        sys.exit(code)  # type: ignore[arg-type]
    os._exit(int(code or 0) & 0xFF)  # type: ignore[call-overload]


if __name__ == "__main__" and _serve(sys.argv[1]):
    _run_command()
