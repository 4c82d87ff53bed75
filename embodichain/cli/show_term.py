"""`embodichain show term NAME`: one registered term: kinds, parameters, docstring, example."""

from __future__ import annotations

import sys
import textwrap
from typing import Any

from embodichain.cli.arguments import print_json
from embodichain.cli.tables import print_table, width
from embodichain.cli.term_entries import SECTION_OF, TermEntry, find_entries

__all__ = ["show_term"]


def show_term(name: str, *, json: bool) -> None:
    """Print what is registered under a name.

    Args:
        name: How configs call it.
        json: Whether as one JSON object.

    Raises:
        ConfigError: If no term has that name.
    """
    entries = find_entries(name)
    if json:
        print_json({"terms": [_facts(entry) for entry in entries]})
        return
    for entry in entries:
        _print(entry)


def _facts(entry: TermEntry) -> dict[str, Any]:
    return {
        "name": entry.name,
        "kinds": list(entry.kinds),
        "signature": entry.signature,
        "parameters": entry.parameters(),
        "doc": entry.doc.text,
        "example": entry.doc.example,
        "defined": entry.spec.place,
    }


def _print(entry: TermEntry) -> None:
    facts = _facts(entry)
    sections = ", ".join(SECTION_OF[kind] for kind in entry.kinds) or "`shape` of a term"
    blocks = [entry.name, f"for: {sections}", facts["signature"], entry.doc.text]
    sys.stdout.write("\n".join(_wrapped(block) + "\n" for block in blocks if block))
    sys.stdout.write("\n")
    if facts["parameters"]:
        rows = [{**row, "default": row["default"] or "(needed)"} for row in facts["parameters"]]
        print_table("parameters", rows)
    if entry.doc.example:
        sys.stdout.write(_wrapped(f"example:\n\n  {entry.doc.example}") + "\n\n")
    sys.stdout.write(f"defined in {facts['defined']}\n")


def _wrapped(text: str) -> str:
    """Text folded to the terminal; lines that fit, and words, stay whole."""
    fold = textwrap.TextWrapper(
        width(), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    return "\n".join("\n".join(fold.wrap(line)) for line in text.splitlines())
