"""`embodichain show`: a task as it would be run, or one term.

The environment is built once and what was built is printed, so that nothing can differ.
"""

from __future__ import annotations

import argparse
import sys

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json, split_overrides
from embodichain.cli.tables import print_facts, print_table
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Print everything of a task, only its resolved config, or one term.

    Raises:
        ConfigError: If there is no such task or term, or the task is wrong.
    """
    parser = VerbParser(VERBS["show"])
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    parser.add_argument("--config", action="store_true", help="only the resolved config, as YAML")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    if options.overrides[:1] == ["term"]:
        return _term(options)
    from embodichain.cli.show_task import DETAIL, for_people, task_tables
    from embodichain.config.frozen import dump_yaml, thaw
    from embodichain.config.resolved import resolve

    resolved = resolve(split_overrides(options.overrides), "run", config_dir=options.config_dir)
    text = dump_yaml(resolved.tree)
    if options.config:
        if options.json:
            print_json({"config": thaw(resolved.tree)})
        else:
            sys.stdout.write(text)
        return exits.OK
    facts = task_tables(resolved)
    if options.json:
        notes = {"notes": [note.as_dict() for note in resolved.notes]} if resolved.notes else {}
        print_json({"task": resolved.task_name, "config": thaw(resolved.tree), **notes, **facts})
        return exits.OK
    sys.stdout.write(f"# {resolved.task_name}, resolved\n{text}\n")
    for note in resolved.notes:
        sys.stdout.write(f"note: {note}\n")
    for title, rows in facts.items():
        if isinstance(rows, dict):
            print_facts(title, rows.items())
        else:
            print_table(title, for_people(title, rows), detail=DETAIL)
    return exits.OK


def _term(options: argparse.Namespace) -> int:
    """`show term NAME`."""
    from embodichain.cli.show_term import show_term

    names = options.overrides[1:]
    if len(names) != 1 or options.config:
        raise ConfigError("show term NAME: one name; `embodichain list terms` lists them")
    show_term(names[0], json=options.json)
    return exits.OK
