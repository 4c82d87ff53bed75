"""`embodichain convert`: EmbodiChain's gym config becomes a task file of ours.

The gym config is only read, and no file is ever replaced.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.gym_config import GymConfig
    from embodichain.config.problems import LocatedProblem

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Print the task, or write it to a new file; say on stderr what could not come along."""
    parser = VerbParser(VERBS["convert"])
    parser.add_argument("file", metavar="FILE", help="EmbodiChain's config: YAML or JSON")
    parser.add_argument("--output", "-o", metavar="OUT", help="a new file; else the terminal")
    add_common(parser)
    options = parser.parse(arguments)
    from embodichain.config.composed import compose
    from embodichain.config.gym_config import load_gym_config, override_of
    from embodichain.config.validation import validate

    if options.output is not None and os.path.lexists(options.output):
        raise ConfigError(f"{options.output} exists; it is never replaced")
    gym = load_gym_config(options.file)
    if gym.problems:
        raise ConfigError(gym.problems)
    text = _task_file(gym, options.file)
    if options.output is not None:
        _write_new(Path(options.output), text)
    left = validate(compose([override_of(options.file)]))
    lists = {"notes": gym.notes, "mistakes": left}
    if options.json:
        listed = {name: [p.as_dict() for p in found] for name, found in lists.items()}
        print_json({"name": gym.name, "task": gym.task, "written": options.output, **listed})
        return exits.OK
    if options.output is None:
        sys.stdout.write(text)
    else:
        sys.stdout.write(f"{options.output}: {gym.name}, from {options.file}\n")
    sys.stderr.write(_list("left out, or read otherwise", gym.notes))
    sys.stderr.write(_list("still wrong in the task", left))
    return exits.OK


def _task_file(gym: GymConfig, source: str) -> str:
    """The task as YAML; its head lists what could not come along."""
    from embodichain.config.frozen import dump_yaml

    head = [f"# Converted from {Path(source).name} by `embodichain convert`."]
    if gym.notes:
        head.append("# Left out, or read otherwise:")
        head += [f"#   {note.path}: {note.message}" for note in gym.notes]
    return "\n".join([*head, dump_yaml(gym.task)])


def _write_new(path: Path, text: str) -> None:
    """Write a file that was not there, whole or not at all."""
    from embodichain.config.run_folder import write_atomically

    whole = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(whole, text)
        try:
            os.link(whole, path)  # unlike a rename, it refuses a name that is taken
        finally:
            whole.unlink()
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error}") from error


def _list(title: str, problems: Iterable[LocatedProblem]) -> str:
    lines = [f"  {problem}\n" for problem in problems]
    return "".join([f"{title} ({len(lines)}):\n", *lines]) if lines else ""
