"""From `sys.argv` to a verb: overview, version, unknown verbs, completion, one place for errors.

Verbs are imported when they are called; nothing heavy is imported here.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from embodichain.cli import exits
from embodichain.cli.reporting import report
from embodichain.cli.starting import starting
from embodichain.cli.stopping import signals_raise
from embodichain.cli.verbs import VERBS, overview
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["main"]

_CALL_STARTED = ("run", "run-env", "train")  # these say when their start is over


def main(argv: list[str] | None = None) -> int:
    """Run the `embodichain` command.

    Args:
        argv: Arguments after the program's name; None takes `sys.argv`.

    Returns:
        0 ok, 1 the run failed, 2 the input is wrong, 130 interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _call(arguments)
    except SystemExit as stop:  # argparse's and Hydra's way out after --help
        return stop.code if isinstance(stop.code, int) else exits.OK
    except BrokenPipeError:  # the reader of a pipe left; Python's manual asks for this redirection
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return exits.FAILED
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  (the last line of defence)
        return report(error, full="--traceback" in arguments)


def _call(arguments: list[str]) -> int:
    first = arguments[0] if arguments else "--help"
    if first in ("-h", "--help", "help"):
        sys.stdout.write(overview())
        return exits.OK
    if first in ("-V", "--version"):
        sys.stdout.write(_versions())
        return exits.OK
    if first in ("-sc", "--shell-completion"):
        from embodichain.cli.completion import complete

        return complete(arguments[1:])
    if first in VERBS:
        start = starting() if first in _CALL_STARTED else nullcontext()
        with signals_raise(), _own_modules(), start:
            module = importlib.import_module(f"embodichain.cli.{first.replace('-', '_')}")
            code: int = module.main(arguments[1:])
            return code
    raise ConfigError(_not_a_verb(first, arguments))


@contextmanager
def _own_modules() -> Iterator[None]:
    """Let a config name functions of modules in the working directory, or in its `src`.

    Its `./conf` is searched too. They come last: nothing that is installed is hidden by them.
    """
    added = [folder for folder in (os.getcwd(), os.path.abspath("src")) if folder not in sys.path]
    sys.path += added
    try:
        yield
    finally:
        for folder in added:
            sys.path.remove(folder)


def _not_a_verb(first: str, arguments: list[str]) -> str:
    if "=" in first or any(a in ("-m", "--multirun") for a in arguments[:1]):
        return f"a verb comes first: embodichain run {' '.join(arguments)}"
    hint = did_you_mean(first, VERBS)
    kind = "option" if first.startswith("-") else "verb"
    return f"unknown {kind} '{first}'.{hint} Verbs: {', '.join(VERBS)}"


def _versions() -> str:
    import platform
    from importlib.metadata import version

    import embodichain

    python = platform.python_version()
    return f"embodichain {embodichain.__version__} (Python {python}, MuJoCo {version('mujoco')})\n"
