"""The process of a command: environment, garbage collection, signals, exit codes, errors.

Imports and builds make a million objects and almost no garbage; repeated collections take a fifth
of the time to the first step. Python's `gc` manual describes this use of `gc.freeze`.

Ctrl-C, SIGTERM and SIGUSR2 (which batch systems can send before they kill a job, as with
`sbatch --signal=USR2@120`) end a run after the current step, a video after the current picture, and
anything else at once; all files are closed before the process ends.
"""

from __future__ import annotations

import _thread
import errno
import gc
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from types import FrameType
from typing import Any

from embodichain.utils.env_text import hidden
from embodichain.utils.errors import ConfigError, Problem, RenderError, merged

__all__ = [
    "FAILED",
    "INTERRUPTED",
    "OK",
    "WRONG_INPUT",
    "Interrupted",
    "StopFlag",
    "check_mujoco_gl",
    "check_text",
    "end_startup",
    "interrupts_say",
    "own_modules",
    "report",
    "signals_raise",
    "starting",
]

OK = 0
FAILED = 1
"""The run or the check failed."""
WRONG_INPUT = 2
"""The input is wrong; nothing was started."""
INTERRUPTED = 130
"""Ctrl-C, SIGTERM or SIGUSR2; the files are complete up to that step."""
_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR2") if hasattr(signal, name)
]
_FAULTS = {
    errno.EIO,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.ESTALE,
    errno.ENOMEM,
    errno.EMFILE,
    errno.ENFILE,
}
"""Errors of the operating system that are about the machine, not about what was typed."""
_GL = "MUJOCO_GL"
_REDELIVERY_S = 10.0
"""Seconds after which a signal is delivered again; removing partial files takes less."""
_TWICE = "interrupted twice: left without closing everything"
_received: list[str] = []
"""Name of the signal for which `signals_raise` raised an exception, until its context is left.

Signal handlers belong to the process, and so does this."""


class Interrupted(KeyboardInterrupt):
    """A signal ended the run after everything was closed.

    It is a KeyboardInterrupt, so that a sweep ends with the job.

    Attributes:
        signal: Its name (``SIGUSR2``), if known.
    """

    signal: str | None = None

    @classmethod
    def by(cls, name: str | None, message: str) -> Interrupted:
        """Return the exception for a signal."""
        error = cls(message)
        error.signal = name
        return error


def check_mujoco_gl() -> None:
    """Import MuJoCo if MUJOCO_GL is set: it loads the library of OpenGL that this names.

    Raises:
        ConfigError: If there is no such library.
    """
    backend = os.environ.get(_GL)
    if not backend:
        return
    try:
        import mujoco  # noqa: F401
    except (AttributeError, ImportError, OSError, RuntimeError) as error:
        message = (
            f"MuJoCo cannot be imported with {backend!r} ({error}); unset it, or use egl, "
            "osmesa (`apt-get install libosmesa6`), glfw (needs a display) or disable"
        )
        raise ConfigError([Problem(_GL, message, source="environment variable")]) from error


def check_text(words: Iterable[str]) -> None:
    """Check that words and paths of the system are text; files of a run are written with them.

    Python reads letters that the locale's encoding lacks as surrogates, which UTF-8 has not.

    Raises:
        ConfigError: One is not text in the encoding of this process.
    """
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as error:
            encoding = sys.getfilesystemencoding()
            hint = "write it in UTF-8"
            if encoding != "utf-8":
                hint = "set LC_ALL=C.UTF-8, or PYTHONUTF8=1"
            raise ConfigError(f"{word} is not text in {encoding}: {hint}") from error


@contextmanager
def starting() -> Iterator[None]:
    """Collect no cyclic garbage inside the context, until `end_startup` is called."""
    gc.disable()
    try:
        yield
    finally:
        end_startup()


def end_startup() -> None:
    """Enable collection again, except for existing objects, most of which are modules."""
    if not gc.isenabled():
        _freeze()
        gc.enable()


@cache
def _freeze() -> None:
    """Freeze once per process: later runs import nothing new, and their garbage is collected."""
    gc.freeze()


@contextmanager
def signals_raise() -> Iterator[None]:
    """Raise `Interrupted` at a signal inside the context, so that partial files are removed.

    Further signals are ignored, except Ctrl-C, which exits at once. Within a `StopFlag`, signals
    set the flag instead.

    Python ignores exceptions in finalizers and weak reference callbacks, and libraries in C may
    discard them. If the context is not left, the signal is delivered again: at once where Python
    reports the exception, otherwise every ten seconds: removing partial files takes less. Where a
    library raises an error of its own instead (HDF5 does), that error becomes `Interrupted` again.
    """
    timers: list[threading.Timer] = []
    hook = sys.unraisablehook
    main = threading.main_thread().ident

    def deliver(number: int, seconds: float) -> None:
        """Send a signal again after a while."""

        def send() -> None:
            _received.clear()
            if hasattr(signal, "pthread_kill"):
                signal.pthread_kill(main or 0, number)
            else:  # Windows
                _thread.interrupt_main(signal.Signals(number))

        timer = threading.Timer(seconds, send)
        timer.daemon = True
        timers.append(timer)
        timer.start()

    def handle(number: int, frame: FrameType | None) -> None:
        """Raise at the first signal, and at each Ctrl-C after it."""
        name = signal.Signals(number).name
        if not _received:
            _received.append(name)
            deliver(number, _REDELIVERY_S)
            raise Interrupted.by(name, f"interrupted ({name})")
        if number == signal.SIGINT:
            raise KeyboardInterrupt(_TWICE)

    def deliver_again(ignored: sys.UnraisableHookArgs) -> None:
        """Send a signal again whose exception Python ignores."""
        if not isinstance(ignored.exc_value, Interrupted):
            hook(ignored)
            return
        timers.pop().cancel()
        deliver(signal.Signals[_received[0]], 0.01)

    sys.unraisablehook = deliver_again
    try:
        with _handled_by(handle):
            try:
                with interrupts_say():
                    yield
            finally:  # before other handlers could receive a signal
                for timer in timers:
                    timer.cancel()
    finally:
        sys.unraisablehook = hook
        _received.clear()


@contextmanager
def interrupts_say(consequence: str = "") -> Iterator[None]:
    """Say in the message of `Interrupted` what the signal has left.

    An error that a library raised in place of `Interrupted` becomes `Interrupted` again.

    Args:
        consequence: For example, "nothing was written".

    Raises:
        Interrupted: A signal came inside the context.
    """
    try:
        yield
    except (Exception, Interrupted) as error:
        if not _received:
            raise
        name = _received[0]
        message = f"interrupted ({name})"
        if isinstance(error, Interrupted):
            message = str(error)
        if consequence:
            message = f"{message}; {consequence}"
        raise Interrupted.by(name, message) from error


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Install a handler for the signals; does nothing outside the main thread."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class StopFlag:
    """Within a ``with`` block, the first signal sets `stopped`; a second Ctrl-C raises at once.

    Outside the main thread (a sweep's worker may be a thread) signals cannot be handled, and
    `stopped` stays None.

    Attributes:
        stopped: Name of the signal that came (``SIGINT``), or None.
    """

    def __init__(self) -> None:
        self.stopped: str | None = None
        self._handled = _handled_by(self._stop)

    def is_stopped(self) -> bool:
        """Return whether a signal came."""
        return self.stopped is not None

    def __enter__(self) -> StopFlag:
        self._handled.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._handled.__exit__(None, None, None)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.stopped is not None and number == signal.SIGINT:
            raise KeyboardInterrupt(_TWICE)
        self.stopped = signal.Signals(number).name


@contextmanager
def own_modules() -> Iterator[None]:
    """Let a config name functions of modules in the working directory, or in its `src`.

    These folders are added at the end of `sys.path`, so that they hide no installed module.
    """
    added = [folder for folder in (os.getcwd(), os.path.abspath("src")) if folder not in sys.path]
    sys.path += added
    try:
        yield
    finally:
        for folder in added:
            sys.path.remove(folder)


def report(error: BaseException, *, full: bool = False) -> int:
    """Print an error on stderr and return the exit code.

    Args:
        error: The exception.
        full: Whether to print the whole traceback (`--traceback`).

    Returns:
        2 when the user's input is wrong, or this machine cannot draw what it asks for; 130 when a
        signal ended the run; else 1, also when the input could not be read or used because the
        disk is full or fails.
    """
    if full and not isinstance(error, Interrupted):
        sys.stderr.write(hidden("".join(traceback.format_exception(error))))
    sys.stderr.write(f"{hidden(_message(error, full=full))}\n")
    sys.stderr.flush()
    return _exit_code(error)


def _exit_code(error: BaseException) -> int:
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, RenderError):
        return WRONG_INPUT
    if not isinstance(error, ConfigError):
        return FAILED
    is_one_fault = len(error.problems) < 2 and _is_fault(error)
    if is_one_fault:
        return FAILED
    return WRONG_INPUT


def _message(error: BaseException, *, full: bool) -> str:
    """The text about an error: a line, or a paragraph for each mistake.

    Args:
        error: The exception.
        full: Whether its traceback is printed.
    """
    if isinstance(error, KeyboardInterrupt):
        return str(error) or "interrupted"
    if not isinstance(error, ConfigError):
        text = f"error: {_line(error)}"
        is_of_system = isinstance(error, OSError) and error.errno is not None
        if not full and not is_of_system:
            text += "\n(--traceback shows where it happened)"
        return text
    problems = merged(error.problems)
    if len(problems) < 2:
        return f"error: {error}"
    lines = [f"{len(problems)} mistakes:"]
    for problem in problems:
        paragraph = str(problem).replace("\n", "\n    ")  # lists of a mistake below it
        lines.append(f"  {paragraph}")
    return "\n".join(lines)


def _is_fault(error: BaseException) -> bool:
    """Whether the machine failed: no other input would have helped."""
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:  # an error that is raised again may be its own
        if isinstance(cause, OSError) and cause.errno in _FAULTS:
            return True
        chain.append(cause)
        cause = cause.__cause__
    return False


def _line(error: BaseException) -> str:
    """The exception and its notes in one line, with its type unless it is of this package.

    An error of the operating system is its reason, then the file that it is about.
    """
    if isinstance(error, OSError) and error.errno is not None and error.strerror:
        files = [str(name) for name in (error.filename, error.filename2) if name is not None]
        if not files:
            return error.strerror
        return f"{error.strerror}: {' -> '.join(files)}"
    texts = [str(error), *getattr(error, "__notes__", ())]
    text = " ".join(" ".join(texts).split())
    name = type(error).__name__
    if not text:
        return name
    if type(error).__module__.startswith("embodichain."):
        return text
    return f"{name}: {text}"
