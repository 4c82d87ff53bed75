"""`embodichain show`: prints a task as it would be run, or one term.

The environment is built and its contents are printed, so that they cannot differ from a run.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.jobs.unread_keys import verb_of_keys
from embodichain.cli.terminal.output import print_facts, print_json, print_table, wrapped
from embodichain.cli.verb import overrides, verb
from embodichain.cli.words import split_overrides
from embodichain.utils.env_text import as_written, hidden_in, shown
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["command"]

_SHOWN_EMPTY = ("rewards", "terminations")
"""Tables whose absence is said in their place; other empty tables share the last line."""


@dataclass(frozen=True)
class ShowOptions:
    """What was typed after `show`.

    Attributes:
        words: Overrides, or ``term`` and the name of a term.
        config: Print only the config, as YAML.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    config: bool
    json: bool


@verb(
    "show",
    ("show task=reach", "columns, times, rewards, terminations, the scene"),
    ("show term within_distance", "what one term takes, with an example"),
    ("show task=reach --config", "only the resolved config, as YAML"),
    ("show task=reach --json", "everything, for scripts"),
    options=ShowOptions,
    keys=True,
    config_dir=True,
)
@overrides("task=NAME [KEY=VALUE]... | term NAME", "term")
@click.option("--config", is_flag=True, help="Only the resolved config, as YAML.")
def command(options: ShowOptions) -> None:
    """Print the tables of a task, only its resolved config, or one term.

    Raises:
        ConfigError: If there is no such task or term, or the task has mistakes.
    """
    if options.words[:1] == ("term",):
        if len(options.words) != 2 or options.config:
            raise ConfigError("show term NAME: one name; `embodichain list terms` lists them")
        _show_term(options.words[1], json=options.json)
        return
    from embodichain.cli.jobs.job import pin_last
    from embodichain.config.resolved import resolve

    overrides = split_overrides(options.words)
    resolved = pin_last(resolve(overrides, verb_of_keys(overrides)))
    if options.config:
        _show_config(resolved, json=options.json)
    else:
        _show_task(resolved, json=options.json)


def _show_config(resolved: Resolved, *, json: bool) -> None:
    """Print the resolved config alone; nothing is built."""
    from embodichain.config.resolved import dump_yaml

    if json:
        print_json({"config": shown(resolved.tree)})
    else:
        sys.stdout.write(dump_yaml(resolved.tree))


def _show_task(resolved: Resolved, *, json: bool) -> None:
    """Build the environment, and print its tables; as JSON with the config."""
    from embodichain.cli.results.show_task import printed_rows, task_tables

    tables = hidden_in(task_tables(resolved))
    if json:
        facts: dict[str, Any] = {"task": resolved.task_name, "config": shown(resolved.tree)}
        if resolved.notes:
            facts["notes"] = [asdict(note) for note in resolved.notes]
        print_json(facts | tables)
        return
    sys.stdout.write(f"task: {resolved.task_name}\n")
    description = as_written(resolved.tree["task"].get("description"))
    if description:
        sys.stdout.write(wrapped(f"description: {description}") + "\n")
    for note in resolved.notes:
        sys.stdout.write(f"note: {note}\n")
    sys.stdout.write("\n")
    for title, rows in tables.items():
        if isinstance(rows, dict) and rows:
            print_facts(title, rows.items())
        elif rows or title in _SHOWN_EMPTY:
            print_table(title, printed_rows(title, rows))
    empty = [title for title, rows in tables.items() if not rows and title not in _SHOWN_EMPTY]
    if empty:
        sys.stdout.write(wrapped(f"without: {', '.join(empty)}") + "\n")
    sys.stdout.write("all of its config: the same command with --config\n")


def _show_term(name: str, *, json: bool) -> None:
    """Print the terms registered under a name."""
    from embodichain.cli.results.terms import find_entries

    entries = find_entries(name)
    if json:
        print_json({"terms": [entry.facts() for entry in entries]})
        return
    for entry in entries:
        sections = f"for: {entry.sections or '`shape` of a term'}"
        for block in (entry.name, sections, entry.signature, entry.doc.text):
            if block:
                sys.stdout.write(f"{wrapped(block)}\n\n")
        parameters = entry.parameters()
        for row in parameters:
            row["default"] = row["default"] or "(needed)"
        if parameters:
            print_table("parameters", parameters)
        if entry.doc.example:
            sys.stdout.write(wrapped(f"example:\n\n  {entry.doc.example}") + "\n\n")
        sys.stdout.write(f"defined in {entry.spec.place}\n")
