"""`embodichain show`: a task as it would be run, or one term.

The environment is built once and what was built is printed, so that nothing can differ.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

import click

from embodichain.cli import exits
from embodichain.cli.app import common, overrides, split_overrides, verb
from embodichain.cli.output import print_facts, print_json, print_table, wrapped
from embodichain.utils.errors import ConfigError

__all__ = ["command"]


@verb(
    "show",
    ("show task=reach", "everything"),
    ("show term within_distance", "what one term takes, with an example"),
    ("show task=reach --config", "only the resolved config, as YAML"),
    ("show task=reach --json", "everything, for scripts"),
    keys=True,
)
@overrides("task=NAME [KEY=VALUE]... | term NAME", "term")
@click.option("--config", is_flag=True, help="Only the resolved config, as YAML.")
@common(config_dir=True)
def command(
    words: tuple[str, ...], config: bool, config_dir: str | None, json: bool, traceback: bool
) -> int:
    """Print everything of a task, only its resolved config, or one term.

    Raises:
        ConfigError: If there is no such task or term, or the task is wrong.
    """
    if words[:1] == ("term",):
        if len(words) != 2 or config:
            raise ConfigError("show term NAME: one name; `embodichain list terms` lists them")
        _show_term(words[1], json=json)
        return exits.OK
    from embodichain.cli.show_task import for_people, task_tables
    from embodichain.config.resolved import dump_yaml, resolve, thaw

    resolved = resolve(split_overrides(words), "run", config_dir=config_dir)
    text = dump_yaml(resolved.tree)
    if config:
        if json:
            print_json({"config": thaw(resolved.tree)})
        else:
            sys.stdout.write(text)
        return exits.OK
    facts = task_tables(resolved)
    if json:
        notes = {"notes": [asdict(note) for note in resolved.notes]} if resolved.notes else {}
        print_json({"task": resolved.task_name, "config": thaw(resolved.tree), **notes, **facts})
        return exits.OK
    sys.stdout.write(f"# {resolved.task_name}, resolved\n{text}\n")
    for note in resolved.notes:
        sys.stdout.write(f"note: {note}\n")
    for title, rows in facts.items():
        if isinstance(rows, dict):
            print_facts(title, rows.items())
        else:
            print_table(title, for_people(title, rows))
    return exits.OK


def _show_term(name: str, *, json: bool) -> None:
    """Print what is registered under a name."""
    from embodichain.cli.terms import SECTION_OF, find_entries

    entries = find_entries(name)
    if json:
        print_json({"terms": [entry.facts() for entry in entries]})
        return
    for entry in entries:
        sections = ", ".join(SECTION_OF[kind] for kind in entry.kinds) or "`shape` of a term"
        blocks = [entry.name, f"for: {sections}", entry.signature, entry.doc.text]
        sys.stdout.write("\n".join(wrapped(block) + "\n" for block in blocks if block))
        sys.stdout.write("\n")
        rows: list[dict[str, Any]] = [*entry.parameters()]
        if rows:
            print_table("parameters", [{**r, "default": r["default"] or "(needed)"} for r in rows])
        if entry.doc.example:
            sys.stdout.write(wrapped(f"example:\n\n  {entry.doc.example}") + "\n\n")
        sys.stdout.write(f"defined in {entry.spec.place}\n")
