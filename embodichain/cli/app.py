"""The `embodichain` command: a click group of verbs, and the decorators that declare a verb.

A verb is the click command ``command`` of the module `embodichain.cli.NAME`, which is imported
when the verb is called or its help is printed.
"""

from __future__ import annotations

import importlib
import itertools
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.shell_completion import BashComplete, add_completion_class, shell_complete

from embodichain.cli.terminal import process
from embodichain.cli.terminal.plain_text import degrading_text
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "EVERYDAY_KEYS",
    "VERBS",
    "Verb",
    "call",
    "command_line",
    "complete_last",
    "job_arguments",
    "log_argument",
    "log_of",
    "main",
    "overrides",
    "pair",
    "split_overrides",
    "verb",
]

VERBS = {
    "demo": "Show a robot that solves a task, in the browser or as a film.",
    "run": "Run a task: simulate, show progress, write a log.",
    "train": "Train a policy with Stable-Baselines3.",
    "eval": "Play a policy for exactly N episodes; print results with confidence intervals.",
    "collect": "Record episodes until enough of them succeeded; resumable.",
    "augment": "Record episodes that repeat recorded ones in other starts of their task.",
    "play": "Show a trained policy in a window.",
    "compare": "Put trainings side by side: a table, and curves with intervals over seeds.",
    "report": "Write one HTML page about a run: results, film, curves, config, how to repeat it.",
    "export": "Write a log in another format, or a policy as one ONNX or TorchScript file.",
    "replay": "Print what a log contains; with --verify simulate it again and compare every bit.",
    "view": "Print how to open a log in Foxglove or Lichtblick; open it, or play it to them.",
    "recover": "Write a clean log from a broken one, up to where it can be read.",
    "diff": "Print the first step and field where two logs differ.",
    "bench": "Measure control steps/s beside the bare batch of the same model.",
    "list": "List tasks, robots, policies, terms, export formats, viewers, learners or steps.",
    "show": "Show a task: resolved config, scene, spaces, terms; or one term.",
    "render": "Write a picture of a task: one environment, or a grid of several.",
    "validate": "Check a task, build it as `run` does, and print every mistake.",
    "convert": "Write EmbodiChain's own config of a task as a task file.",
    "run-env": "EmbodiChain's command: run --gym-config, with its flags.",
    "new": "Write a new task and its test into your folder or package.",
    "doctor": "Check this machine: versions, threads, rendering, disk, optional packages.",
}
"""Verb -> its description, in the order of `--help`."""

EVERYDAY_KEYS = (
    *("task", "num_envs", "episodes", "max_steps", "total_timesteps", "seed", "policy"),
    *("record", "viewer", "device", "sim", "output_dir"),
)
_KEYS = f"""Keys:
  {" ".join(EVERYDAY_KEYS)}
  all of them, with their values: embodichain show task=NAME --config

"""
_EXIT_CODES = "Exit codes: 0 ok, 1 the run failed, 2 wrong input, 130 interrupted\n"
_OVERVIEW = f"""
Completion: eval "$(embodichain -sc install=bash)" (or zsh, fish)

Examples:
  embodichain run task=random_reach num_envs=4
  embodichain replay last --verify
  embodichain list tasks

{_EXIT_CODES}"""
_ROOT_KEYS = (
    *EVERYDAY_KEYS,
    *("algo", "video", "resume", "dataset", "scene_png", "allow_changed", "trust", "experiment"),
)
"""Keys that are flags of other tools."""
_QUICK_START = ("run", "run-env", "train")
"""Verbs that call `process.started` once their start-up is over."""
_COMPLETE = "_EMBODICHAIN_COMPLETE"
_UNINSTALL = {
    "bash": "complete -r embodichain",
    "zsh": "compdef -d embodichain",
    "fish": "complete -c embodichain -e",
}
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class Verb(click.Command):
    """A verb whose help ends with examples.

    Attributes:
        examples: Pairs of arguments and their description.
        keys: Whether it takes ``key=value`` overrides.
    """

    examples: tuple[tuple[str, str], ...] = ()
    keys = False

    def invoke(self, ctx: click.Context) -> Any:
        """Call the verb, if its words are text and MuJoCo can be imported.

        `doctor` says why not.
        """
        if self.name != "doctor":
            process.check_text([*(ctx.find_root().obj or ()), os.getcwd()])
            process.check_mujoco_gl()
        return super().invoke(ctx)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write keys, examples and exit codes, unwrapped."""
        width = max(len(arguments) for arguments, _ in self.examples)
        lines = [f"  embodichain {a:<{width}}   {what}".rstrip() for a, what in self.examples]
        keys = _KEYS if self.keys else ""
        formatter.write("\n".join([f"\n{keys}Examples:", *lines, f"\n{_EXIT_CODES}"]))


class _Verbs(click.Group):
    """The verbs, imported one by one."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        module = importlib.import_module(f"embodichain.cli.verbs.{cmd_name.replace('-', '_')}")
        found: click.Command = module.command
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(_OVERVIEW)

    def shell_complete(
        self, ctx: click.Context, incomplete: str
    ) -> list[click.shell_completion.CompletionItem]:
        item = click.shell_completion.CompletionItem
        return [item(name, help=VERBS[name]) for name in VERBS if name.startswith(incomplete)]


def _version(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if not value or ctx.resilient_parsing:
        return
    import platform
    from importlib.metadata import version

    import embodichain

    python = platform.python_version()
    own = f"embodichain {embodichain.__version__}"
    click.echo(f"{own} (Python {python}, MuJoCo {version('mujoco')})")
    ctx.exit()


def _completion(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Print the shell code that turns completion of this command on or off."""
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
    *("--version", "-V"),
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_version,
    help="Versions of embodichain, Python and MuJoCo.",
)
@click.option(
    *("-sc", "--shell-completion"),
    metavar="install=SHELL",
    is_eager=True,
    expose_value=False,
    callback=_completion,
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
    arguments = list(sys.argv[1:] if argv is None else argv)
    with degrading_text():
        if _COMPLETE in os.environ:
            return shell_complete(_cli, {}, "embodichain", _COMPLETE, os.environ[_COMPLETE])
        try:
            return call(arguments)
        except SystemExit as stop:  # raised by Hydra
            return stop.code if isinstance(stop.code, int) else process.OK
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
    key, _, value = first.removeprefix("--").replace("-", "_").partition("=")
    if first.startswith("--") and key in _ROOT_KEYS:
        value = value or next((word for word in arguments[1:2] if "=" not in word), "VALUE")
        raise ConfigError(f"a verb comes first: embodichain run {key}={value}, without dashes")
    if "=" in first or first in ("-m", "--multirun"):
        raise ConfigError(f"a verb comes first: embodichain run {' '.join(arguments)}")
    words = ["--help"] if first == "help" else list(arguments)
    line = ["embodichain", *arguments]
    try:
        with (
            process.signals_raise(),
            _own_modules(),
            process.starting() if first in _QUICK_START else nullcontext(),
            _cli.make_context("embodichain", words, obj=line) as context,
        ):
            code: int | None = _cli.invoke(context)
            return code or process.OK
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoSuchCommand as error:
        hint = _of_task(error.command_name) or did_you_mean(error.command_name, VERBS)
        verbs = ", ".join(VERBS)
        message = f"no such verb: '{error.command_name}'.{hint} There are: {verbs}."
        raise ConfigError(message) from error
    except click.NoSuchOption as error:
        raise ConfigError(_instead_of_flag(error, arguments)) from error
    except click.UsageError as error:
        program = error.ctx.command_path if error.ctx is not None else "embodichain"
        message = f"{error.format_message()}{_without_keys(error, arguments)}"
        raise ConfigError(f"{message}\nTry '{program} --help'.") from error


def _of_task(name: str) -> str:
    """What to type instead, if a word in place of the verb is the name of a task."""
    from embodichain.config import list_options  # Hydra: only when needed

    return f" To run the task: embodichain run task={name}." if name in list_options("task") else ""


def _without_keys(error: click.UsageError, arguments: list[str]) -> str:
    """That a verb takes no overrides, if some were typed; else empty."""
    command = error.ctx.command if error.ctx is not None else None
    typed = [word for word in arguments[1:] if "=" in word and not word.startswith("-")]
    if not isinstance(command, Verb) or command.keys or not typed:
        return ""
    return f": `{command.name}` reads no KEY=VALUE"


def _instead_of_flag(error: click.NoSuchOption, arguments: list[str]) -> str:
    """The message about an unknown option; for ``--num_envs 4`` it says to type ``num_envs=4``."""
    program = error.ctx.command_path if error.ctx is not None else "embodichain"
    message = f"{error.format_message()}\nTry '{program} --help'."
    command = error.ctx.command if error.ctx is not None else None
    if not (isinstance(command, Verb) and command.keys):
        return message
    if not error.option_name.startswith("--"):
        return f"{message} Values are given as key=value, without dashes."
    typed = error.option_name.removeprefix("--")
    key = typed.replace("-", "_")
    if key not in _ROOT_KEYS and "." not in key:
        return message
    place = next(i for i, word in enumerate(arguments) if word.partition("=")[0] == f"--{typed}")
    value = arguments[place].partition("=")[2]
    after = arguments[place + 1 : place + 2]
    if not value and after and "=" not in after[0] and not after[0].startswith("-"):
        value = after[0]
    return f"there is no option --{typed}: write {key}={value or _example(key)}, without dashes"


def _example(key: str) -> str:
    """What to write for a key whose value was not typed: flags of other tools have none."""
    return "NAME" if key in ("task", "policy", "device") else "VALUE"


@contextmanager
def _own_modules() -> Iterator[None]:
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


# -- declaring verbs -------------------------------------------------------------------------------


def _search_first(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    ctx.meta["config_dir"] = value
    if value is not None and not ctx.resilient_parsing:
        from embodichain.config.composition.hydra_loader import user_configs

        ctx.with_resource(user_configs(value))


_CONFIG_DIR = click.Option(
    ["--config-dir", "-cd"],
    metavar="DIR",
    expose_value=False,
    callback=_search_first,
    help="Search this folder for YAML first.",
)
_QUIET = click.Option(["--quiet", "-q"], is_flag=True, help="No progress, no report.")
_OUTPUT = (
    click.Option(["--json"], is_flag=True, help="One JSON object on stdout."),
    click.Option(
        ["--traceback"], is_flag=True, expose_value=False, help="Show where an error happened."
    ),
)
_JOB_OPTIONS = (
    click.option(
        *("--gym-config",),
        metavar="FILE",
        help="EmbodiChain's own config of a task, instead of task=NAME.",
    ),
    click.option("--multirun", "-m", is_flag=True, help="One job for each value."),
    click.option(
        *("--cfg", "-c"),
        type=click.Choice(("job", "hydra", "all")),
        help="Print the config instead of running.",
    ),
    click.option("--resolve", is_flag=True, help="With --cfg: resolve interpolations."),
    click.option("--package", "-p", metavar="KEY", help="With --cfg: only this part."),
    click.option(
        *("--info", "-i"),
        type=click.Choice(("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")),
        is_flag=False,
        flag_value="all",
        help="Print how the config was composed.",
    ),
)


def verb(
    name: str,
    *examples: tuple[str, str],
    keys: bool = False,
    config_dir: bool = False,
    quiet: bool = False,
) -> Callable[[Callable[..., int | None]], Verb]:
    """Make a function the verb `name`; the function returns the exit code, or None for 0.

    Every verb has `--json`, which is passed to the function, and `--traceback`.

    Args:
        name: One of `VERBS`.
        *examples: Arguments after ``embodichain``, and their description.
        keys: Whether it takes ``key=value`` overrides.
        config_dir: Whether it has `--config-dir`, which applies while the function runs.
        quiet: Whether it has `--quiet`, which is passed to the function.
    """

    def make(function: Callable[..., int | None]) -> Verb:
        command = click.command(name, cls=Verb, help=VERBS[name])(function)
        command.params += [_CONFIG_DIR] * config_dir + [_QUIET] * quiet + [*_OUTPUT]
        command.examples, command.keys = examples, keys
        return command

    return make


def overrides(metavar: str = "[KEY=VALUE]...", *words: str, config: str = "run") -> Decorator:
    """Add the argument `words`, which takes overrides in Hydra's grammar and names.

    Args:
        metavar: Its name in the help text.
        *words: Names that are completed besides keys.
        config: The root config whose keys are completed: ``run``, ``train`` or ``collect``.
    """
    complete = partial(_complete, config=config, names=words)
    return click.argument("words", nargs=-1, metavar=metavar, shell_complete=complete)


def _complete(
    ctx: click.Context,
    parameter: click.Parameter,
    incomplete: str,
    *,
    config: str,
    names: tuple[str, ...],
) -> list[str]:
    from embodichain.config.composition.completion import complete_override

    found = [name for name in names if incomplete and name.startswith(incomplete)]
    if found:
        return found
    before = [w for w in ctx.params.get("words") or () if "=" in w or w.startswith("~")]
    with _own_modules():
        return complete_override(incomplete, before, config, ctx.meta.get("config_dir"))


def job_arguments(config: str) -> Decorator:
    """Add the arguments of jobs: overrides and Hydra's flags.

    Args:
        config: The root config: ``run``, ``train`` or ``collect``.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(_JOB_OPTIONS):
            function = option(function)
        return overrides("[task=NAME] [KEY=VALUE]...", config=config)(function)

    return add


def log_argument(metavar: str = "FILE", name: str = "file") -> Decorator:
    """Add an argument that names a log (see `log_of`)."""
    return click.argument(name, metavar=metavar, shell_complete=complete_last)


def complete_last(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the word `last`, which means the newest run."""
    return ["last"] if "last".startswith(incomplete) else []


def log_of(name: str) -> Path:
    """Return the log of a name: a file, a run's folder, or ``last`` for the newest run.

    Temporary files of processes that were killed are removed from its folder.

    Raises:
        ConfigError: There is no log yet, no such file, or the folder has none.
    """
    from embodichain.config.run_folder import LOG, SHARDS, newest_run, perhaps_last
    from embodichain.utils.system.atomic import remove_abandoned

    path = newest_run("outputs", LOG, SHARDS) if name == "last" else Path(name)
    if path is None:
        raise ConfigError("no run in outputs has a log yet: embodichain run task=NAME")
    if name == "last":
        from embodichain.cli.terminal.last import take_last

        take_last(path)
    if not path.exists():
        raise ConfigError(f"{name} does not exist{perhaps_last(name)}")
    remove_abandoned(path if path.is_dir() else path.parent)
    if not path.is_dir():
        return path
    log = path.resolve() / LOG
    if not log.exists() and (path / SHARDS).exists():
        return path.resolve() / SHARDS
    if not log.exists():
        raise ConfigError(f"{path.resolve()} has no {LOG}: {_why_no_log(path)}")
    return log


def _why_no_log(folder: Path) -> str:
    """Why a run's folder has no log, as its config says."""
    from embodichain.config.rerun import read_config
    from embodichain.config.run_folder import CONFIG, SUMMARY

    if not (folder / CONFIG).is_file():
        return f"it is no run's folder, which has a {CONFIG}"
    record = read_config(folder / CONFIG).get("record")
    if isinstance(record, dict) and record.get("format") == "none":
        return "it was run with record=none"
    if (folder / SUMMARY).is_file():
        return "the run failed before its log began, or the log was moved"
    return "the run ended, or was killed, before its log began"


def command_line() -> list[str]:
    """Return the command line of the verb that is running."""
    return list(click.get_current_context().find_root().obj)


def split_overrides(words: tuple[str, ...]) -> list[str]:
    """Return words as overrides; a word without ``=`` is the name of the task.

    Raises:
        ConfigError: More than one bare word, or a map or list that the shell has split.
    """
    _check_quotes(words)
    if "=" in words:
        at = words.index("=")
        typed = "".join(words[max(at - 1, 0) : at + 2])
        raise ConfigError(f"write {typed}, without blanks around =")
    bare = [word for word in words if "=" not in word and not word.startswith("~")]
    _check_blanks(words, bare)
    if len(bare) > 1:
        raise ConfigError(f"one task at a time: {', '.join(bare)}. Values are given as key=value")
    return [*(f"task={word}" for word in bare), *(word for word in words if word not in bare)]


def _check_blanks(words: tuple[str, ...], bare: list[str]) -> None:
    """Refuse ``task reach``, ``task: reach``, ``task= reach`` and ``task =reach``, by the form."""
    for word, value in itertools.pairwise(words):
        key = word.rstrip("=:")
        split = word.endswith("=") or (word in bare and key in _ROOT_KEYS)
        if value.startswith("=") or (split and value in bare):
            whole = f"{key}={value.lstrip('=')}"
            if _open_brackets(whole):
                following = words[words.index(value) + 1 :]
                whole = _quoted(" ".join([whole, *following]))
            raise ConfigError(f"write {whole}, without a blank after the key")


def _check_quotes(words: tuple[str, ...]) -> None:
    """Refuse ``KEY={func: NAME}`` without quotes, of which a shell makes two words."""
    for i, word in enumerate(words):
        if "=" not in word or not _open_brackets(word):
            continue
        whole = word
        for following in words[i + 1 :]:
            whole += f" {following}"
            if not _open_brackets(whole):
                key = word.lstrip("+").partition("=")[0]
                new = "" if word.startswith("+") else f"; a new entry is +{key}=..."
                raise ConfigError(f"put quotes around it for your shell: {_quoted(whole)}{new}")
        raise ConfigError(f"{word!r} has a bracket without its other one")


def _quoted(word: str) -> str:
    """Return a word in quotes for a shell, double ones if it has single ones."""
    double = "'" in word and not set(word) & set('"$`\\')
    return f'"{word}"' if double else shlex.quote(word)


def _open_brackets(text: str) -> bool:
    """Whether brackets or quotes of a text are open at its end."""
    closing = {"{": "}", "[": "]", "(": ")"}
    wanted: list[str] = []
    quote, escaped = "", False
    for sign in text.partition("=")[2]:
        if escaped:
            escaped = False
        elif sign == "\\":
            escaped = True
        elif quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in closing:
            wanted.append(closing[sign])
        elif wanted and sign == wanted[-1]:
            wanted.pop()
    return bool(wanted)


def pair(option: str, text: str, form: str) -> tuple[int, int]:
    """Return the numbers of an option's value such as ``640x480``.

    Args:
        option: The option.
        text: Its value.
        form: The allowed form, for the message.

    Raises:
        ConfigError: The value has another form, or a number is 0.
    """
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if found is None:
        raise ConfigError(f"{option} is {form}, not {text!r}")
    return int(found[1]), int(found[2])
