"""Descriptions of registered terms for `list terms`, `show term` and the page docs/terms.md."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

import yaml

from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import (
    SECTIONS,
    SHAPES,
    TERMS,
    VALUE_KINDS,
    Kind,
    TermSpec,
    config_word,
)
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "SECTION_OF",
    "TermDoc",
    "TermEntry",
    "all_entries",
    "catalogue",
    "find_entries",
    "parse_doc",
    "shape_entries",
    "type_words",
]

SECTION_OF: dict[Kind, str] = {kind: section for section, kind in SECTIONS.items()}
"""Kind of term -> section of a task, in the order of pages and tables."""
_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Example|Examples|Note|Yields):\s*$")
_ENTRY = re.compile(r"^\*{0,2}(\w+)(?: \([^)]*\))?: (.*)$")


@dataclass(frozen=True, slots=True)
class TermDoc:
    """The parts of a google-style docstring.

    Attributes:
        summary: Its first paragraph, on one line.
        text: The paragraphs before the first section, the summary among them.
        params: Argument -> its description on one line.
        example: YAML on one line that declares the term; empty if there is none.
    """

    summary: str = ""
    text: str = ""
    params: dict[str, str] = field(default_factory=dict)
    example: str = ""


@dataclass(frozen=True, slots=True)
class TermEntry:
    """One function or class registered under one name.

    Attributes:
        name: Its name in configs.
        kinds: The managers that run it; none for a shape.
        spec: Its registration under the first of these.
        doc: Its docstring; for an alias, its meaning.
    """

    name: str
    kinds: tuple[Kind, ...]
    spec: TermSpec
    doc: TermDoc

    @property
    def sections(self) -> str:
        """The sections of a task in which it may be used; empty for a shape."""
        return ", ".join(SECTION_OF[kind] for kind in self.kinds)

    @property
    def signature(self) -> str:
        """``name(a, b=1)``, with the parameters that configs may set."""
        return f"{self.name}({', '.join(_short(*item) for item in self.spec.params.items())})"

    def parameters(self) -> list[dict[str, str]]:
        """One row per parameter: name, type with its range, default, description."""
        hints = self.spec.hints()
        return [
            {
                "parameter": name,
                "type": type_words(hints[name]),
                "default": _default(parameter),
                "what": self.doc.params.get(name) or _description(hints[name]),
            }
            for name, parameter in self.spec.params.items()
        ]

    def facts(self) -> dict[str, Any]:
        """Return all its properties, for JSON."""
        facts: dict[str, Any] = {
            "name": self.name,
            "kinds": list(self.kinds),
            "signature": self.signature,
        }
        facts |= {"parameters": self.parameters(), "doc": self.doc.text}
        return {**facts, "example": self.doc.example, "defined": self.spec.place}


def all_entries() -> list[TermEntry]:
    """Every registered term, by section, then by name; one registered twice is one entry."""
    found: dict[tuple[str, Any], list[TermSpec]] = {}
    for kind in SECTION_OF:
        for name, spec in sorted(TERMS[kind].items()):
            found.setdefault((name, spec.func), []).append(spec)
    return [
        TermEntry(name, tuple(cast("Kind", s.kind) for s in specs), specs[0], _doc_of(specs[0]))
        for (name, _), specs in found.items()
    ]


def shape_entries() -> list[TermEntry]:
    """Every shape (function of a quantity), in the order of its module."""
    TERMS["reward"]  # shapes are registered with the terms
    return [TermEntry(name, (), spec, parse_doc(spec.doc)) for name, spec in SHAPES.items()]


def _doc_of(spec: TermSpec) -> TermDoc:
    return _doc_of_alias(spec) if isinstance(spec, AliasSpec) else parse_doc(spec.doc)


def _doc_of_alias(spec: AliasSpec) -> TermDoc:
    """Describe an alias by the docstrings of its target and shapes."""
    docs = [parse_doc(part.doc) for part in spec.parts]
    first: dict[str, Any] = yaml.safe_load(docs[0].example)
    params: dict[str, Any] = yaml.safe_load(spec.example) if spec.example else {}
    for name, (part, key) in spec.exposed.items() if not params else ():
        written = first.get("params", {})
        given = {meant: written[key] for key, meant in spec.target.written(written).items()}
        if part:
            shape = yaml.safe_load(docs[part].example)["shape"]
            given = _parameters_of(shape, spec.steps[part - 1])
        if key in given:
            params[name] = given[key]
    example = {k: v for k, v in first.items() if k not in ("shape", "weight", "params")}
    example["func"] = spec.name
    if params:
        example["params"] = params
    text = yaml.safe_dump(example, default_flow_style=True, sort_keys=False, width=10_000)
    shown = docs[: 1 + len(spec.steps)]
    return TermDoc(
        summary=f"{spec.doc} {docs[0].summary}",
        text="\n\n".join([spec.doc, *(doc.summary for doc in shown)]),
        params={
            name: spec.texts.get(name) or docs[part].params.get(key, "")
            for name, (part, key) in spec.exposed.items()
        },
        example=text.strip(),
    )


def _parameters_of(written: Any, shape: TermSpec) -> dict[str, Any]:
    """Parameters of one shape in an example's `shape`."""
    for step in written if isinstance(written, list) else [written]:
        given = step.get(shape.name) if isinstance(step, dict) else None
        if given is not None:
            return given if isinstance(given, dict) else {next(iter(shape.params)): given}
    return {}


def find_entries(name: str) -> list[TermEntry]:
    """Return the terms and shapes with a name; several if more than one kind has it.

    Raises:
        ConfigError: If there is none; names the closest.
    """
    entries = [*all_entries(), *shape_entries()]
    found = [entry for entry in entries if entry.name == name]
    if not found:
        hint = did_you_mean(name, [entry.name for entry in entries])
        raise ConfigError(f"no term is called '{name}'.{hint} `embodichain list terms` lists them.")
    return found


def _short(name: str, parameter: inspect.Parameter) -> str:
    """``name`` if the parameter is required, else ``name=default``."""
    required = parameter.default is inspect.Parameter.empty
    return name if required else f"{name}={parameter.default}"


def _default(parameter: inspect.Parameter) -> str:
    """A default as YAML; empty if the parameter is required."""
    value = parameter.default
    if value is inspect.Parameter.empty:
        return ""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(list(value)) if isinstance(value, tuple) else str(value)


# -- docstrings ------------------------------------------------------------------------------------


@cache
def parse_doc(doc: str) -> TermDoc:
    """Parse a docstring, as `inspect.getdoc` returns it."""
    parts: dict[str, list[str]] = {"": []}
    current = ""
    for line in doc.splitlines():
        if (found := _SECTION.match(line)) is not None:
            current = found[1]
            parts.setdefault(current, [])
        else:
            parts[current].append(line)
    blocks = re.split(r"\n\s*\n", "\n".join(parts[""]).strip("\n"))
    # Indented paragraphs (formulas, lists) keep their lines.
    paragraphs = [
        block if re.match(r"\s|[*-] ", block) else " ".join(block.split())
        for block in blocks
        if block.strip()
    ]
    return TermDoc(
        summary=paragraphs[0] if paragraphs else "",
        text="\n\n".join(paragraphs),
        params=_entries(parts.get("Args", [])),
        example=" ".join(" ".join(parts.get("Example", [])).split()).strip("`"),
    )


def _entries(lines: list[str]) -> dict[str, str]:
    """``name: text`` entries; deeper indented lines continue the one before."""
    found: dict[str, str] = {}
    name = ""
    for line in textwrap.dedent("\n".join(lines)).splitlines():
        entry = _ENTRY.match(line)
        if entry is not None:
            name = config_word(entry[1])
            found[name] = entry[2].strip()
        elif name and line.strip():
            found[name] = f"{found[name]} {line.strip()}"
    return found


def _description(hint: Any) -> str:
    """The description of a type, which serves every parameter of that type."""
    parts = [*getattr(hint, "__metadata__", ()), *map(_description, get_args(hint))]
    found = (p if isinstance(p, str) else getattr(p, "description", None) for p in parts)
    return next((text for text in found if text), "")


# -- types in words -------------------------------------------------------------------------------

_WORDS: dict[Any, str] = {
    Any: "anything",
    bool: "true or false",
    float: "number",
    int: "integer",
    str: "text",
    type(None): "null",
    dict: "map",
    list: "list",
    tuple: "list",
}
_NAMED = {
    "NamedEntity": "entity",
    "ResolvedEntity": "entity",
    "SceneEntityCfg": "entity",
    "TermCfg": "term",
}
_LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def type_words(hint: Any) -> str:
    """Return a description of a type's values in YAML.

    Args:
        hint: An evaluated annotation: ``Annotated[float, Field(gt=0)]`` gives ``number > 0``.
    """
    metadata: list[Any] = []
    if get_origin(hint) is Annotated:
        hint, *outer = get_args(hint)
        metadata = [part for item in outer for part in getattr(item, "metadata", [item])]
    origin, arguments = get_origin(hint), get_args(hint)
    name = getattr(hint, "__name__", str(hint))
    if origin in (Union, types.UnionType):
        words = " or ".join(dict.fromkeys(map(type_words, arguments)))
    elif origin is Literal:
        words = " or ".join(map(str, arguments))
    elif origin is not None:
        return _container(origin, arguments, metadata)
    elif dataclasses.is_dataclass(hint) and name not in _NAMED:
        words = f"map with {', '.join(field.name for field in dataclasses.fields(hint))}"
    else:
        words = _NAMED.get(name) or _WORDS.get(hint, name)
    found = [(sign, getattr(part, key, None)) for part in metadata for key, sign in _LIMITS.items()]
    limits = " and ".join(f"{sign} {value:g}" for sign, value in found if value is not None)
    return f"{words} {limits}".strip()


def _container(origin: Any, arguments: tuple[Any, ...], metadata: list[Any]) -> str:
    """Describe a list or a map; pairs with a further check are bounds."""
    item = type_words(arguments[0]) if arguments else "anything"
    if issubclass(origin, Mapping):
        return f"map of {type_words(arguments[-1])}" if arguments else "map"
    if not issubclass(origin, Iterable):
        return str(origin.__name__)
    lengths = {
        key: value
        for part in metadata
        for key in ("min_length", "max_length")
        if (value := getattr(part, key, None)) is not None
    }
    least = lengths.get("min_length")
    count = least if least == lengths.get("max_length") else None
    if origin is tuple and arguments and arguments[-1] is not Ellipsis:
        if len(set(map(str, arguments))) > 1:
            return f"[{', '.join(map(type_words, arguments))}]"
        count = len(arguments)
    if count is None:
        return f"list of {item}" + (f", at least {least}" if least else "")
    if count == 2 and any(hasattr(part, "func") for part in metadata):
        return "[low, high]" if item == "number" else f"[low, high], each {item}"
    return f"{count} {item.replace('number', 'numbers', 1)}"


# -- the page docs/terms.md -----------------------------------------------------------------------

_BUILTIN = "embodichain."
_QUANTITIES = (
    "Serve observations, rewards, terminations and metrics, except where a line says otherwise."
)
_OTHERS = """\
`embodichain show term NAME` lists the parameters; those in capitals have another name than in the
term."""


def catalogue() -> str:
    """Return the page. Terms of other packages are not on it."""
    head = resources.files("embodichain.cli") / "templates" / "terms.md.tmpl"
    entries = [e for e in all_entries() if e.spec.func.__module__.startswith(_BUILTIN)]
    aliases = [e for e in entries if isinstance(e.spec, AliasSpec) and not e.spec.makers]
    described = [e for e in entries if e not in aliases]
    values = [e for e in described if set(e.kinds) & set(VALUE_KINDS)]
    lines = [head.read_text(encoding="utf-8")]
    parts: dict[str, list[TermEntry]] = {"quantities": values, "shapes": shape_entries()}
    for kind, section in SECTION_OF.items():
        if kind not in VALUE_KINDS:
            parts[section] = [e for e in described if kind in e.kinds]
    lines += [f"* [{title}](#{title}): {len(found)}" for title, found in parts.items()]
    lines += [f"* [other names](#other-names): {len(aliases)}"]
    for title, found in parts.items():
        lines += ["", f"## {title}", "", *([_QUANTITIES, ""] if title == "quantities" else [])]
        lines += [line for entry in found for line in _term(entry)]
    lines += ["", "## other names", "", _OTHERS, ""]
    meanings = [e.spec.doc.removeprefix("Alias of ").replace("``", "`") for e in aliases]
    rows = [
        (f"`{entry.name}`", entry.sections, meaning.rstrip("."))
        for entry, meaning in zip(aliases, meanings, strict=True)
    ]
    lines += _rows(("name", "for", "alias of"), rows)
    return "\n".join(lines).rstrip("\n") + "\n"


def _term(entry: TermEntry) -> Iterator[str]:
    yield from (f"### {entry.name}", "", entry.doc.text, "")
    notes = [f"For {entry.sections}."] if set() < set(entry.kinds) < set(VALUE_KINDS) else []
    if entry.spec.func.__module__.startswith("embodichain.compat."):
        notes.append("With the name and parameters of EmbodiChain's.")
    if notes:
        yield from (" ".join(notes), "")
    rows = [
        (
            f"`{row['parameter']}`",
            row["type"],
            f"`{row['default']}`" if row["default"] else "needed",
            row["what"],
        )
        for row in entry.parameters()
    ]
    if rows:
        yield from (*_rows(("parameter", "type", "default", "what"), rows), "")
    if entry.doc.example:
        yield from (f"Example: `{entry.doc.example}`", "")


def _rows(names: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """A table in Markdown."""
    for row in (names, ("---",) * len(names)):
        yield f"| {' | '.join(row)} |"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
