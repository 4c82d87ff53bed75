"""What the docstring of a term says, in parts: description, parameters, example. Text only."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache

__all__ = ["TermDoc", "parse_doc"]

_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Example|Examples|Note|Yields):\s*$")
_ENTRY = re.compile(r"^\*{0,2}(\w+)(?: \([^)]*\))?: (.*)$")


@dataclass(frozen=True, slots=True)
class TermDoc:
    """A google-style docstring, taken apart.

    Attributes:
        summary: Its first paragraph, on one line.
        text: The paragraphs before the first section, the summary among them.
        params: What each argument is, on one line.
        example: YAML on one line that declares the term; empty if there is none.
    """

    summary: str = ""
    text: str = ""
    params: dict[str, str] = field(default_factory=dict)
    example: str = ""


@cache
def parse_doc(doc: str) -> TermDoc:
    """Take a docstring apart.

    Args:
        doc: As `inspect.getdoc` returns it.
    """
    parts: dict[str, list[str]] = {"": []}
    current = ""
    for line in doc.splitlines():
        if (found := _SECTION.match(line)) is not None:
            current = found[1]
            parts.setdefault(current, [])
        else:
            parts[current].append(line)
    paragraphs = _paragraphs(parts[""])
    return TermDoc(
        summary=paragraphs[0] if paragraphs else "",
        text="\n\n".join(paragraphs),
        params=_entries(parts.get("Args", [])),
        example=" ".join(" ".join(parts.get("Example", [])).split()).strip("`"),
    )


def _paragraphs(lines: list[str]) -> list[str]:
    """Paragraphs as one line each; indented ones (formulas, lists) keep their lines."""
    blocks = re.split(r"\n\s*\n", "\n".join(lines).strip("\n"))
    plain = (b for b in blocks if b.strip())
    return [b if re.match(r"\s|[*-] ", b) else " ".join(b.split()) for b in plain]


def _entries(lines: list[str]) -> dict[str, str]:
    """``name: text`` entries; deeper indented lines go on with the one before."""
    indent = min((len(x) - len(x.lstrip()) for x in lines if x.strip()), default=0)
    found: dict[str, str] = {}
    name = ""
    for line in lines:
        entry = _ENTRY.match(line[indent:])
        if entry is not None:
            name = entry[1].removesuffix("_")  # `from_` is written `from`
            found[name] = entry[2].strip()
        elif name and line.strip():
            found[name] = f"{found[name]} {line.strip()}"
    return found
