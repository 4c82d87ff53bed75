"""`embodichain ARGUMENTS` in processes of their own that do not import everything anew.

One process has imported what the verbs need, two seconds of CPU time, and has checked a config;
each command is a fork of it: with its own pid, pipes or terminal, working directory and signals. It
ends as any interpreter does, but for the modules that are taken apart then. What is about the start
itself (imports, encodings, variables that libraries read) needs a real ``python -m embodichain``.
"""

from __future__ import annotations

import atexit
import fcntl
import io
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import IO, NoReturn

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


class Process:
    """A process that was started, whatever it prints into.

    Args:
        arguments: After the name of the program.
        connection: To the process that waits for it.
        program: The module that runs.

    Attributes:
        args: The command, as it is typed.
        pid: Of its process.
        returncode: None until it was seen to have ended; negative for a signal.
    """

    def __init__(
        self, arguments: tuple[str, ...], connection: socket.socket, program: str = "embodichain"
    ) -> None:
        self.args = (program, *arguments)
        self.returncode: int | None = None
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

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL, unless it has ended."""
        self.send_signal(signal.SIGKILL)


class Command(Process):
    """A command that was started; its methods are those of `subprocess.Popen`.

    Args:
        arguments: After the name of the program.
        connection: To the process that waits for it.
        stdout: The descriptor of what it prints.
        stderr: Likewise.
        program: The module that runs.

    Attributes:
        stdout: What it prints.
        stderr: What it prints there.
    """

    def __init__(
        self,
        arguments: tuple[str, ...],
        connection: socket.socket,
        stdout: int,
        stderr: int,
        program: str = "embodichain",
    ) -> None:
        self.stdout: IO[str] = os.fdopen(stdout, encoding="utf-8")
        self.stderr: IO[str] = os.fdopen(stderr, encoding="utf-8")
        super().__init__(arguments, connection, program)

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


class Commands:
    """Starts commands.

    Args:
        address: Of the process that forks.
    """

    def __init__(self, address: str) -> None:
        self._address = address

    def start(
        self,
        *arguments: str,
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        program: str = "embodichain",
        safe_path: bool = False,
    ) -> Command:
        """Start a command.

        Args:
            arguments: After ``embodichain``.
            cwd: Its working directory; None is the current one.
            env: All of its environment variables; None is those of this process.
            program: The module that runs, as with ``python -m``.
            safe_path: Whether modules are not looked for in the working directory, as with
                ``python -P`` and commands that pip has installed.
        """
        out, out_end = os.pipe()
        err, err_end = os.pipe()
        variables = dict(os.environ if env is None else env)
        request = {
            "arguments": arguments,
            "program": program,
            "env": variables,
            "safe_path": safe_path,
        }
        connection = self._ask(request, cwd, [out_end, err_end])
        return Command(arguments, connection, out, err, program)

    def start_in_terminal(
        self, *arguments: str, terminal: int, cwd: Path, env: Mapping[str, str]
    ) -> Process:
        """Start a command whose input and output are a terminal, which it controls.

        Args:
            arguments: After ``embodichain``.
            terminal: The descriptor of the command's end of a pseudo terminal; it is closed here.
            cwd: Its working directory.
            env: All of its environment variables.
        """
        request = {
            "arguments": arguments,
            "program": "embodichain",
            "env": dict(env),
            "safe_path": False,
        }
        return Process(arguments, self._ask(request, cwd, [terminal]))

    def run(
        self,
        *arguments: str,
        cwd: Path | None = None,
        timeout: float = 120.0,
        program: str = "embodichain",
        safe_path: bool = False,
    ) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, as `subprocess.run` with captured output; see `start`."""
        command = self.start(*arguments, cwd=cwd, program=program, safe_path=safe_path)
        try:
            out, err = command.communicate(timeout)
        finally:
            command.kill()
        return subprocess.CompletedProcess(command.args, command.wait(), out, err)

    def _ask(
        self, request: dict[str, object], cwd: Path | None, descriptors: list[int]
    ) -> socket.socket:
        """Send a request with descriptors, which are closed here; return the connection."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.connect(self._address)
        message = json.dumps({**request, "cwd": str(cwd or Path.cwd())}).encode()
        socket.send_fds(connection, [message], descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        return connection


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


def _serve(address: str) -> str:
    """Fork commands until stdin is closed; returns the program of such a fork, else nothing."""
    import_first()
    _check_a_config()
    folder = Path(address).parent
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address)
        listener.listen()
        print("ready", flush=True)
        while sys.stdin not in (ready := select.select([sys.stdin, listener], [], [])[0]):
            connection, _ = ready[0].accept()
            message, descriptors, _, _ = socket.recv_fds(connection, _LONGEST, 2)
            for note in folder.glob("*.json"):
                import_again(json.loads(note.read_text()))
                note.unlink()
            keeper = os.fork()
            if not keeper:
                listener.close()
                if _forked(connection, descriptors):
                    request = json.loads(message)
                    _become(request)
                    atexit.register(_note_imports, folder, os.getpid(), set(sys.modules))
                    return str(request["program"])
            for descriptor in (connection.detach(), *descriptors):
                os.close(descriptor)
            with suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
    return ""


def _check_a_config() -> None:
    """Check the config of a task, so that the forks have what is kept in memory.

    No thread is started, since a fork has none.
    """
    from embodichain.cli.app import main

    with redirect_stdout(io.StringIO()):
        main(["validate", "task=cart_pole"])


def _forked(connection: socket.socket, descriptors: list[int]) -> bool:
    """Fork the command, in which True is returned; the process between waits and tells its end.

    Args:
        connection: To whoever has asked.
        descriptors: Two for stdout and stderr, or a terminal.
    """
    pid = os.fork()
    if not pid:
        connection.close()
        if len(descriptors) == 1:
            (terminal,) = descriptors
            os.setsid()
            fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)
            streams = (terminal, terminal, terminal)
        else:
            streams = (os.open(os.devnull, os.O_RDONLY), *descriptors)
        for number, descriptor in enumerate(streams):
            os.dup2(descriptor, number)
        for descriptor in {*streams}:
            os.close(descriptor)
        return True
    for descriptor in descriptors:
        os.close(descriptor)
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
    if request["safe_path"]:
        del sys.path[0]
    else:
        sys.path[0] = str(request["cwd"])
    sys.argv[1:] = list(request["arguments"])  # type: ignore[call-overload]


def _note_imports(folder: Path, pid: int, before: set[str]) -> None:
    """Write what the command has imported, for the process that forks."""
    if os.getpid() != pid or not folder.is_dir():
        return  # a process that the command has forked; or nobody forks any more
    part = folder / f"{pid}.part"
    part.write_text(json.dumps(imported_since(before)))
    part.rename(folder / f"{pid}.json")


def _run(program: str) -> NoReturn:
    """Run a module as ``python -m`` does, and end this process."""
    code = 0
    is_interrupted = False
    try:
        runpy.run_module(program, run_name="__main__", alter_sys=True)
    except SystemExit as error:
        code = _exit_code(error)
    except BaseException as error:  # noqa: BLE001  (an interpreter prints it and ends)
        sys.excepthook(type(error), error, error.__traceback__)
        code = 1
        is_interrupted = isinstance(error, KeyboardInterrupt)
    if "COVERAGE_PROCESS_CONFIG" in os.environ:
        sys.exit(code)  # coverage writes its file at the very end
    # What an interpreter does as it ends, in its order, but for taking apart modules: that is 0.3 s
    # of CPU time, as torch has many. These two functions have no public names.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            if not stream.closed:
                stream.flush()
        except OSError as error:  # nobody reads it
            os.write(2, f"Exception ignored in: {stream}\n{error!r}\n".encode())
            code = 120
    if is_interrupted:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(code)


def _exit_code(error: SystemExit) -> int:
    """Return the exit code, and print what is not a number, as an interpreter does."""
    if error.code is None:
        return 0
    if isinstance(error.code, int):
        return error.code
    print(error.code, file=sys.stderr)
    return 1


if __name__ == "__main__":
    program_of_fork = _serve(sys.argv[1])
    if program_of_fork:
        _run(program_of_fork)
