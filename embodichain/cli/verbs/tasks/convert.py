"""`embodichain convert`: converts EmbodiChain's gym config to a task file.

The gym config is not changed, and no file is overwritten.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import verb
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.config.composition.gym_config import GymConfig

__all__ = ["command"]


@dataclass(frozen=True)
class ConvertOptions:
    """What was typed after `convert`.

    Attributes:
        file: Path of EmbodiChain's own config.
        output: Path of a new file; None prints it.
        json: Print the result as one JSON object.
    """

    file: str
    output: str | None
    json: bool


@verb(
    "convert",
    ("convert gym_config.yaml", "print the task, and what cannot be converted"),
    ("convert gym_config.json -o conf/task/push.yaml", "write it; then: run task=push"),
    options=ConvertOptions,
)
@click.argument("file", metavar="FILE")
@click.option("--output", "-o", metavar="OUT", help="A new file. Default: print it.")
def command(options: ConvertOptions) -> None:
    """Print the task, or write it to a new file; list on stderr what could not be converted."""
    from embodichain.config.checks.validation import validate
    from embodichain.config.composition.composed import compose
    from embodichain.config.composition.gym_config import load_gym_config, override_of

    if options.output is not None and os.path.lexists(options.output):
        raise ConfigError(f"{options.output} exists; it is never replaced")
    gym = load_gym_config(options.file)
    if gym.problems:
        raise ConfigError(gym.problems)
    text = _task_file(gym, options.file)
    if options.output is not None:
        _write_new(Path(options.output), text)
    mistakes = validate(compose([override_of(options.file)]))
    if options.json:
        print_json(
            {
                "name": gym.name,
                "task": gym.task,
                "written": options.output,
                "notes": [asdict(note) for note in gym.notes],
                "mistakes": [asdict(mistake) for mistake in mistakes],
            }
        )
        return
    if options.output is None:
        sys.stdout.write(text)
    else:
        sys.stdout.write(f"{options.output}: {gym.name}, from {options.file}\n")
    sys.stderr.write(_list("left out, or read otherwise", gym.notes))
    sys.stderr.write(_list("still wrong in the task", mistakes))


def _task_file(gym: GymConfig, source: str) -> str:
    """The task as YAML; comments at the top list what could not be converted."""
    from embodichain.config.resolved import dump_yaml

    head = [f"# Converted from {Path(source).name} by `embodichain convert`."]
    if gym.notes:
        head.append("# Left out, or read otherwise:")
        head += [f"#   {note.path}: {note.message}" for note in gym.notes]
    return "\n".join([*head, dump_yaml(gym.task)])


def _write_new(path: Path, text: str) -> None:
    """Write a new file atomically."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text, new=True)
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error}") from error


def _list(title: str, problems: Iterable[Problem]) -> str:
    lines = [f"  {problem}\n" for problem in problems]
    if not lines:
        return ""
    return "".join([f"{title} ({len(lines)}):\n", *lines])
