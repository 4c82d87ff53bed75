"""The `embodichain` command: a click group of verbs, which `cli.verb` lists and declares.

A verb is the click command ``command`` of the module `embodichain.cli.verbs.FOLDER.NAME`, which is
imported when the verb is called or its help is printed.
"""

from __future__ import annotations

import importlib
import os
import sys
from contextlib import nullcontext

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    add_completion_class,
    shell_complete,
)

from embodichain.cli.terminal import process
from embodichain.cli.terminal.plain_text import degrading_text
from embodichain.cli.verb import EXIT_CODES, VERBS, Verb
from embodichain.cli.words import ADVICE_ELSEWHERE, NAMES_ELSEWHERE, ROOT_KEYS
from embodichain.utils.errors import ConfigError
from embodichain.utils.notes import forget_shown
from embodichain.utils.suggest import did_you_mean

__all__ = ["call", "load_verb", "main"]

_OVERVIEW = f"""
Completion: eval "$(embodichain -sc install=bash)" (or zsh, fish)

Examples:
  embodichain run task=random_reach num_envs=4
  embodichain replay last --verify
  embodichain list tasks

{EXIT_CODES}"""
_STARTING_VERBS = ("run", "run-env", "train")
"""Verbs that call `process.end_startup` once their start-up is over."""
_COMPLETE = "_EMBODICHAIN_COMPLETE"
"""Variable of the environment with which a shell asks for completions."""
_UNINSTALL = {
    "bash": "complete -r embodichain",
    "zsh": "compdef -d embodichain",
    "fish": "complete -c embodichain -e",
}


def load_verb(name: str) -> Verb:
    """Import the module of a verb, one of `VERBS`, and return its command."""
    folder = VERBS[name].folder
    module_name = name.replace("-", "_")
    module = importlib.import_module(f"embodichain.cli.verbs.{folder}.{module_name}")
    return module.command


class _Verbs(click.Group):
    """The verbs, imported one by one."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        return load_verb(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl([(name, entry.description) for name, entry in VERBS.items()])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(_OVERVIEW)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        return [
            CompletionItem(name, help=entry.description)
            for name, entry in VERBS.items()
            if name.startswith(incomplete)
        ]


def _print_version(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Print the versions, and end."""
    if not value or ctx.resilient_parsing:
        return
    import platform
    from importlib.metadata import version

    import embodichain

    libraries = f"Python {platform.python_version()}, MuJoCo {version('mujoco')}"
    click.echo(f"embodichain {embodichain.__version__} ({libraries})")
    ctx.exit()


def _print_completion(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Print the shell code that turns completion of this command on or off, and end."""
    if value is None or ctx.resilient_parsing:
        return
    action, _, shell = value.partition("=")
    if action not in ("install", "uninstall") or shell not in _UNINSTALL:
        raise ConfigError("-sc takes install=SHELL or uninstall=SHELL; SHELL is bash, zsh or fish")
    if action == "uninstall":
        click.echo(_UNINSTALL[shell])
    else:
        shell_complete(_cli, {}, "embodichain", _COMPLETE, f"{shell}_source")
    ctx.exit()


class _Bash(BashComplete):
    """Completes ``key=value`` as one word, and adds no blank after ``key=`` and ``key.``."""

    source_template = "COMP_WORDBREAKS=${COMP_WORDBREAKS//=}\n" + (
        BashComplete.source_template.replace(
            "COMPREPLY+=($value)",
            "COMPREPLY+=($value)\n            [[ $value == *[=.] ]] && compopt -o nospace",
        )
    )


add_completion_class(_Bash)


@click.command(
    cls=_Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    subcommand_metavar="VERB [ARGUMENTS]",
    options_metavar="",
)
@click.option(
    "--version",
    "-V",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Versions of embodichain, Python and MuJoCo.",
)
@click.option(
    "-sc",
    "--shell-completion",
    metavar="install=SHELL",
    is_eager=True,
    expose_value=False,
    callback=_print_completion,
    help="Completion for bash, zsh or fish.",
)
def _cli() -> None:
    """One YAML tree is one robot experiment: scene, task, learning, and a log that replays."""


def main(argv: list[str] | None = None) -> int:
    """Run the `embodichain` command.

    Args:
        argv: Arguments after the program's name; None takes `sys.argv`.

    Returns:
        0 ok, 1 the run failed, 2 the input is wrong, 130 interrupted.
    """
    arguments = sys.argv[1:] if argv is None else list(argv)
    forget_shown()
    with degrading_text():
        if _COMPLETE in os.environ:
            return shell_complete(_cli, {}, "embodichain", _COMPLETE, os.environ[_COMPLETE])
        try:
            return call(arguments)
        except SystemExit as stop:  # raised by Hydra, or by code of a task
            if stop.code is None:
                return process.OK
            if isinstance(stop.code, int):
                return stop.code
            sys.stderr.write(f"{stop.code}\n")  # as Python does at its end
            return process.FAILED
        except BrokenPipeError:  # the pipe's reader closed it; redirection as in Python's manual
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return process.FAILED
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  (reported, with a code)
            return process.report(error, full="--traceback" in arguments)


def call(arguments: list[str]) -> int:
    """Call a verb; errors are raised.

    Args:
        arguments: The verb and its arguments.

    Returns:
        The exit code.
    """
    first = arguments[0] if arguments else "help"
    # Click would take the key for a verb or an option of its own.
    _check_first_word(first, arguments)
    words = list(arguments)
    if first == "help":
        words = ["--help"]
    line = ["embodichain", *arguments]
    try:
        with (
            process.signals_raise(),
            process.own_modules(),
            process.starting() if first in _STARTING_VERBS else nullcontext(),
            _cli.make_context("embodichain", words, obj=line) as context,
        ):
            code: int | None = _cli.invoke(context)
            return code or process.OK
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoSuchCommand as error:
        hint = _task_hint(error.command_name) or did_you_mean(error.command_name, VERBS)
        verbs = ", ".join(VERBS)
        message = f"no such verb: '{error.command_name}'.{hint} There are: {verbs}."
        raise ConfigError(message) from error
    except click.NoSuchOption as error:
        raise ConfigError(_option_message(error, arguments)) from error
    except click.UsageError as error:
        message = f"{error.format_message()}{_keys_hint(error, arguments)}"
        raise ConfigError(f"{message}\n{_help_hint(error)}") from error


def _check_first_word(first: str, arguments: list[str]) -> None:
    """Refuse a command line that begins with a key, with or without dashes.

    Raises:
        ConfigError: It does; the message begins with a verb.
    """
    key, _, value = first.removeprefix("--").replace("-", "_").partition("=")
    if first.startswith("--") and key in ROOT_KEYS:
        if not value and len(arguments) > 1 and "=" not in arguments[1]:
            value = arguments[1]
        assignment = f"{key}={value or 'VALUE'}"
        raise ConfigError(f"a verb comes first: embodichain run {assignment}, without dashes")
    if "=" in first or first in ("-m", "--multirun"):
        raise ConfigError(f"a verb comes first: embodichain run {' '.join(arguments)}")


def _help_hint(error: click.UsageError) -> str:
    """A sentence that names the help of the command which refused its arguments."""
    command = "embodichain"
    if error.ctx is not None:
        command = error.ctx.command_path
    return f"Try '{command} --help'."


def _verb_of(error: click.UsageError) -> Verb | None:
    """The verb that refused its arguments; None if it was the command itself."""
    if error.ctx is None or not isinstance(error.ctx.command, Verb):
        return None
    return error.ctx.command


def _task_hint(name: str) -> str:
    """A command to type instead, if a word in place of the verb is the name of a task."""
    from embodichain.config import list_options  # Hydra: only when needed

    if name not in list_options("task"):
        return ""
    return f" To run the task: embodichain run task={name}."


def _keys_hint(error: click.UsageError, arguments: list[str]) -> str:
    """A note that a verb takes no overrides, if some were typed; else empty."""
    command = _verb_of(error)
    overrides = [word for word in arguments[1:] if "=" in word and not word.startswith("-")]
    if command is None or command.keys or not overrides:
        return ""
    return f": `{command.name}` reads no KEY=VALUE"


def _option_message(error: click.NoSuchOption, arguments: list[str]) -> str:
    """The message about an unknown option; for ``--num_envs 4`` it says to type ``num_envs=4``."""
    message = f"{error.format_message()}\n{_help_hint(error)}"
    command = _verb_of(error)
    if command is None or not command.keys:
        return message
    if not error.option_name.startswith("--"):
        return f"{message} Values are given as key=value, without dashes."
    name = error.option_name.removeprefix("--")
    key = name.replace("-", "_")
    advice = ADVICE_ELSEWHERE.get(key)
    if advice is not None:
        return f"there is no option --{name}: {advice}"
    key = NAMES_ELSEWHERE.get(key, key)
    if key not in ROOT_KEYS and "." not in key:
        return message
    value = _value_of_option(error.option_name, arguments) or _example_value(key)
    return f"there is no option --{name}: write {key}={value}, without dashes"


def _value_of_option(option: str, arguments: list[str]) -> str:
    """The value of ``--option=value`` or ``--option value``; empty if none was typed."""
    names = [word.partition("=")[0] for word in arguments]
    index = names.index(option)
    value = arguments[index].partition("=")[2]
    if value or index + 1 == len(arguments):
        return value
    following = arguments[index + 1]
    is_value = "=" not in following and not following.startswith("-")
    return following if is_value else ""


def _example_value(key: str) -> str:
    """A placeholder for a key whose value was not typed: flags of other tools have none."""
    if key in ("task", "policy", "device"):
        return "NAME"
    return "VALUE"
