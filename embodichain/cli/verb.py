"""What a verb is, and the decorators that declare one.

A verb is the click command ``command`` of the module `embodichain.cli.verbs.FOLDER.NAME`. What was
typed arrives in its function as one frozen dataclass, whose fields are the names of its options:

    @dataclass(frozen=True)
    class Options:
        path: str
        json: bool

    @verb("recover", ("recover last saved.mcap", "what the help says of it"), options=Options)
    @log_argument("IN", "path")
    def command(options: Options) -> None: ...
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import click

from embodichain.cli.terminal import process
from embodichain.cli.words import EVERYDAY_KEYS

__all__ = [
    "EXIT_CODES",
    "VERBS",
    "JobOptions",
    "OverrideOptions",
    "Verb",
    "VerbEntry",
    "command_line",
    "complete_last",
    "job_arguments",
    "log_argument",
    "overrides",
    "verb",
]


@dataclass(frozen=True)
class VerbEntry:
    """A verb in the list of verbs, whose module is not imported for it.

    Attributes:
        folder: The folder of `embodichain.cli.verbs` with its module.
        description: What the help says of it.
    """

    folder: str
    description: str


VERBS = {
    "demo": VerbEntry("running", "Show a robot that solves a task, in the browser or as a film."),
    "run": VerbEntry("running", "Run a task: simulate, show progress, write a log."),
    "train": VerbEntry("learning", "Train a policy with Stable-Baselines3."),
    "eval": VerbEntry(
        "learning", "Play a policy for exactly N episodes; print results with confidence intervals."
    ),
    "collect": VerbEntry("learning", "Record episodes until enough of them succeeded; resumable."),
    "augment": VerbEntry(
        "learning", "Record new episodes that repeat recorded ones from other starts."
    ),
    "play": VerbEntry("running", "Show a trained policy in a window."),
    "compare": VerbEntry(
        "learning", "Put trainings side by side: a table, and curves with intervals over seeds."
    ),
    "study": VerbEntry(
        "learning", "Train, evaluate and compare what one YAML file declares; resumable."
    ),
    "report": VerbEntry(
        "logs", "Write one HTML page about a run: results, film, curves, config, how to repeat it."
    ),
    "export": VerbEntry(
        "logs", "Write a log in another format, or a policy as one ONNX or TorchScript file."
    ),
    "replay": VerbEntry(
        "logs", "Print what a log contains; with --verify simulate it again and compare every bit."
    ),
    "verify": VerbEntry(
        "logs", "Check a receipt: its files, its numbers, the physics and the policy's actions."
    ),
    "impact": VerbEntry(
        "logs", "Play logs again after a change: which episodes part, where, and by how much."
    ),
    "view": VerbEntry(
        "logs", "Print how to open a log in Foxglove or Lichtblick; open it, or play it to them."
    ),
    "recover": VerbEntry(
        "logs", "Write a clean log from a broken one, up to where it can be read."
    ),
    "diff": VerbEntry("logs", "Print the first step and field where two logs differ."),
    "bench": VerbEntry(
        "running", "Measure control steps/s beside the bare batch of the same model."
    ),
    "list": VerbEntry(
        "tasks", "List tasks, robots, policies, terms, export formats, viewers, learners or steps."
    ),
    "show": VerbEntry("tasks", "Show a task: resolved config, scene, spaces, terms; or one term."),
    "render": VerbEntry(
        "tasks", "Write a picture of a task: one environment, or a grid of several."
    ),
    "validate": VerbEntry(
        "tasks", "Check a task, build it as `run` does, and print every mistake."
    ),
    "convert": VerbEntry("tasks", "Write EmbodiChain's own config of a task as a task file."),
    "run-env": VerbEntry("running", "EmbodiChain's command: run --gym-config, with its flags."),
    "new": VerbEntry("tasks", "Write a new task and its test into your folder or package."),
    "doctor": VerbEntry(
        "running", "Check this machine: versions, threads, rendering, disk, optional packages."
    ),
}
"""The verbs, in the order of `--help`."""

_KEYS = f"""Keys:
  {" ".join(EVERYDAY_KEYS)}
  all of them, with their values: embodichain show task=NAME --config

"""
EXIT_CODES = "Exit codes: 0 ok, 1 the run failed, 2 wrong input, 130 interrupted\n"
Options = TypeVar("Options")
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class Verb(click.Command):
    """A verb whose help ends with examples.

    Attributes:
        examples: Pairs of arguments and their description.
        options: The dataclass with a field for each option and argument.
        keys: Whether it takes ``key=value`` overrides.
    """

    examples: tuple[tuple[str, str], ...] = ()
    options: type[Any] = object
    keys = False

    def invoke(self, ctx: click.Context) -> Any:
        """Call the verb, after a check that its words are text and that MuJoCo can be imported.

        `doctor` is called in any case: it says what is wrong with the machine.
        """
        if self.name != "doctor":
            process.check_text([*(ctx.find_root().obj or ()), os.getcwd()])
            process.check_mujoco_gl()
        return super().invoke(ctx)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write keys, examples and exit codes, unwrapped."""
        width = max(len(arguments) for arguments, _ in self.examples)
        keys = _KEYS if self.keys else ""
        lines = [f"\n{keys}Examples:"]
        for arguments, description in self.examples:
            lines.append(f"  embodichain {arguments:<{width}}   {description}".rstrip())
        lines.append(f"\n{EXIT_CODES}")
        formatter.write("\n".join(lines))


def _use_config_dir(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Search a folder for YAML first, while the verb runs."""
    ctx.meta["config_dir"] = value
    if value is not None and not ctx.resilient_parsing:
        from embodichain.config.composition.hydra_loader import user_configs

        ctx.with_resource(user_configs(value))


_CONFIG_DIR = click.Option(
    ["--config-dir", "-cd"],
    metavar="DIR",
    expose_value=False,
    callback=_use_config_dir,
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
        "--gym-config",
        metavar="FILE",
        help="EmbodiChain's own config of a task, instead of task=NAME.",
    ),
    click.option("--multirun", "-m", is_flag=True, help="One job for each value."),
    click.option(
        "--cfg",
        "-c",
        type=click.Choice(("job", "hydra", "all")),
        help="Print the config instead of running.",
    ),
    click.option("--resolve", is_flag=True, help="With --cfg: resolve interpolations."),
    click.option("--package", "-p", metavar="KEY", help="With --cfg: only this part."),
    click.option(
        "--info",
        "-i",
        type=click.Choice(("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")),
        is_flag=False,
        flag_value="all",
        help="Print how the config was composed.",
    ),
)


@dataclass(frozen=True, kw_only=True)
class OverrideOptions:
    """What was typed after a verb that runs jobs.

    Attributes:
        words: Overrides, and names of tasks or runs.
        quiet: Print no progress and no report.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    quiet: bool = False
    json: bool = False


@dataclass(frozen=True, kw_only=True)
class JobOptions(OverrideOptions):
    """What was typed after `run`, `train` or `collect`.

    Attributes:
        gym_config: Path of EmbodiChain's own config of a task, instead of ``task=NAME``.
        multirun: Run one job for each combination of values.
        cfg: Print this part of the config instead of running: ``job``, ``hydra`` or ``all``.
        resolve: With `cfg`: resolve interpolations.
        package: With `cfg`: print only this key.
        info: Print this about how the config was composed, instead of running.
    """

    gym_config: str | None = None
    multirun: bool = False
    cfg: str | None = None
    resolve: bool = False
    package: str | None = None
    info: str | None = None


def verb(
    name: str,
    *examples: tuple[str, str],
    options: type[Options],
    keys: bool = False,
    config_dir: bool = False,
    quiet: bool = False,
) -> Callable[[Callable[[Options], int | None]], Verb]:
    """Make a function the verb `name`; the function returns the exit code, or None for 0.

    Every verb has `--json`, which is a field of its options, and `--traceback`, which is not.

    Args:
        name: One of `VERBS`.
        *examples: Arguments after ``embodichain``, and their description.
        options: The dataclass that the function gets; it has a field for each option.
        keys: Whether it takes ``key=value`` overrides.
        config_dir: Whether it has `--config-dir`, which applies while the function runs.
        quiet: Whether it has `--quiet`, which is a field, too.
    """

    def make(function: Callable[[Options], int | None]) -> Verb:
        @functools.wraps(function)  # click keeps declared options in the function's attributes
        def call(**values: Any) -> int | None:
            return function(options(**values))

        command = click.command(name, cls=Verb, help=VERBS[name].description)(call)
        if config_dir:
            command.params.append(_CONFIG_DIR)
        if quiet:
            command.params.append(_QUIET)
        command.params += _OUTPUT
        command.examples = examples
        command.options = options
        command.keys = keys
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

    matching_names = [name for name in names if incomplete and name.startswith(incomplete)]
    if matching_names:
        return matching_names
    words = ctx.params.get("words") or ()
    earlier_overrides = [word for word in words if "=" in word or word.startswith("~")]
    config_dir = ctx.meta.get("config_dir")
    with process.own_modules():
        return complete_override(incomplete, earlier_overrides, config, config_dir)


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
    if "last".startswith(incomplete):
        return ["last"]
    return []


def command_line() -> list[str]:
    """Return the command line of the verb that is running."""
    return list(click.get_current_context().find_root().obj)
