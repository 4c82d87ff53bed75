"""`embodichain show`: prints a task as it would be run, or one term.

The environment is built and its contents are printed, so that they cannot differ from a run.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from typing import Any

import click

from embodichain.cli.jobs.unread_keys import verb_of_keys
from embodichain.cli.terminal.output import print_facts, print_json, print_table, wrapped
from embodichain.cli.verb import overrides, verb
from embodichain.cli.words import split_overrides
from embodichain.utils.env_text import hidden_in, shown
from embodichain.utils.errors import ConfigError

__all__ = ["command"]


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
    ("show task=reach", "everything"),
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
    """Print all tables of a task, only its resolved config, or one term.

    Raises:
        ConfigError: If there is no such task or term, or the task has mistakes.
    """
    if options.words[:1] == ("term",):
        if len(options.words) != 2 or options.config:
            raise ConfigError("show term NAME: one name; `embodichain list terms` lists them")
        _show_term(options.words[1], json=options.json)
        return
    from embodichain.cli.jobs.job import pinned
    from embodichain.cli.results.show_task import task_tables, without_defaults
    from embodichain.config.resolved import dump_yaml, resolve

    lines = split_overrides(options.words)
    resolved = pinned(resolve(lines, verb_of_keys(lines)))
    tables = {} if options.config else hidden_in(task_tables(resolved))
    if options.json:
        about = {"config": shown(resolved.tree)}
        if not options.config:
            notes = [asdict(note) for note in resolved.notes]
            about = {"task": resolved.task_name, **about, **({"notes": notes} if notes else {})}
        print_json({**about, **tables})
        return
    text = dump_yaml(resolved.tree)
    sys.stdout.write(text if options.config else f"# {resolved.task_name}, resolved\n{text}\n")
    for note in [] if options.config else resolved.notes:
        sys.stdout.write(f"note: {note}\n")
    for title, rows in tables.items():
        if isinstance(rows, dict):
            print_facts(title, rows.items())
        else:
            print_table(title, without_defaults(title, rows))


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
            sys.stdout.write(f"{wrapped(block)}\n\n" if block else "")
        rows: list[dict[str, Any]] = [*entry.parameters()]
        if rows:
            print_table("parameters", [{**r, "default": r["default"] or "(needed)"} for r in rows])
        if entry.doc.example:
            sys.stdout.write(wrapped(f"example:\n\n  {entry.doc.example}") + "\n\n")
        sys.stdout.write(f"defined in {entry.spec.place}\n")
