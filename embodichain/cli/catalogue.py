"""The catalogue of terms as a page of Markdown, made from what is registered.

`embodichain list terms --markdown > docs/terms.md` writes the one in docs.
"""

from __future__ import annotations

from collections.abc import Iterator

from embodichain.cli.term_entries import SECTION_OF, TermEntry, all_entries

__all__ = ["catalogue"]

_HEAD = """\
# Terms

Made by `embodichain list terms --markdown`: every function that a task can name, by the section it
stands in, with its parameters and an example that a test builds. `embodichain show term NAME` says
the same on the terminal. Units are SI and radians unless a line says otherwise; an *entity* is a
reference such as `{uid: ur10, link_names: [ee_link]}`; `[low, high]` bounds are ordered.
"""
_BUILTIN = "embodichain."


def catalogue() -> str:
    """Return the page. Terms of other packages are not on it."""
    entries = [e for e in all_entries() if e.spec.func.__module__.startswith(_BUILTIN)]
    lines = [_HEAD, *_contents(entries)]
    for kind, section in SECTION_OF.items():
        lines += ["", f"## {section}", ""]
        lines += _section([e for e in entries if kind in e.kinds], kind)
    return "\n".join(lines).rstrip("\n") + "\n"


def _contents(entries: list[TermEntry]) -> Iterator[str]:
    for kind, section in SECTION_OF.items():
        count = sum(kind in entry.kinds for entry in entries)
        yield f"* [{section}](#{section}): {count}"


def _section(entries: list[TermEntry], kind: str) -> Iterator[str]:
    """The terms whose first kind this is in full, the others by name."""
    for entry in entries:
        if entry.kinds[0] == kind:
            yield from _term(entry)
    others = [f"[`{e.name}`](#{e.name})" for e in entries if e.kinds[0] != kind]
    if others:
        yield f"Above, and of use here too: {', '.join(others)}."
    if not entries:
        yield "None yet."


def _term(entry: TermEntry) -> Iterator[str]:
    yield f"### {entry.name}"
    yield ""
    yield entry.doc.text
    yield ""
    rows = entry.parameters()
    if rows:
        yield "| parameter | type | default | what |"
        yield "| --- | --- | --- | --- |"
        for row in rows:
            default = f"`{row['default']}`" if row["default"] else "needed"
            cells = (f"`{row['parameter']}`", row["type"], default, row["what"])
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
        yield ""
    if entry.doc.example:
        yield f"Example: `{entry.doc.example}`"
        yield ""
