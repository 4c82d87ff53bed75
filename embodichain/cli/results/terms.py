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
_PROPER_NAMES = ("Euclidean",)
"""First words of docstrings that keep their capital within a sentence."""


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
        arguments = [_argument(name, parameter) for name, parameter in self.spec.params.items()]
        return f"{self.name}({', '.join(arguments)})"

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
        return {
            "name": self.name,
            "kinds": list(self.kinds),
            "signature": self.signature,
            "parameters": self.parameters(),
            "doc": self.doc.text,
            "example": self.doc.example,
            "defined": self.spec.place,
        }


def all_entries() -> list[TermEntry]:
    """Every registered term, by section, then by name; one registered twice is one entry."""
    registrations: dict[tuple[str, Any], list[TermSpec]] = {}
    for kind in SECTION_OF:
        for name, spec in sorted(TERMS[kind].items()):
            registrations.setdefault((name, spec.func), []).append(spec)
    entries = []
    for (name, _), specs in registrations.items():
        kinds = tuple(cast("Kind", spec.kind) for spec in specs)
        entries.append(TermEntry(name=name, kinds=kinds, spec=specs[0], doc=_doc_of(specs[0])))
    return entries


def shape_entries() -> list[TermEntry]:
    """Every shape (function of a quantity), in the order of its module."""
    TERMS["reward"]  # shapes are registered with the terms
    return [
        TermEntry(name=name, kinds=(), spec=spec, doc=parse_doc(spec.doc))
        for name, spec in SHAPES.items()
    ]


def _doc_of(spec: TermSpec) -> TermDoc:
    if isinstance(spec, AliasSpec):
        return _doc_of_alias(spec)
    return parse_doc(spec.doc)


def _doc_of_alias(spec: AliasSpec) -> TermDoc:
    """Describe an alias by the docstrings of its target and shapes."""
    docs = [parse_doc(part.doc) for part in spec.parts]
    return TermDoc(
        summary=f"{spec.doc} {docs[0].summary}",
        text=f"{spec.doc}\n\n{_meaning_of_alias(spec, docs)}",
        params={
            name: spec.texts.get(name) or docs[part].params.get(key, "")
            for name, (part, key) in spec.exposed.items()
        },
        example=_example_of_alias(spec, docs),
    )


def _meaning_of_alias(spec: AliasSpec, docs: Sequence[TermDoc]) -> str:
    """What an alias computes, in one sentence, the last shape first.

    ``The value is `l2` (sum of squares) of `joint_velocity` ((N, J) rad/s or m/s).``

    Args:
        spec: The alias.
        docs: The docstrings of its parts.
    """
    if not spec.steps:
        return docs[0].summary
    parts = []
    for part, doc in zip((spec.target, *spec.steps), docs, strict=False):
        summary = doc.summary.rstrip(".")
        if summary.partition(" ")[0] not in _PROPER_NAMES and summary[1:2].islower():
            summary = summary[0].lower() + summary[1:]
        parts.append(f"`{part.name}` ({summary})")
    return f"The value is {' of '.join(reversed(parts))}."


def _example_of_alias(spec: AliasSpec, docs: Sequence[TermDoc]) -> str:
    """YAML that declares an alias: its target's example under its name, with its parameters.

    Args:
        spec: The alias.
        docs: The docstrings of its parts.
    """
    target_example: dict[str, Any] = yaml.safe_load(docs[0].example)
    params: dict[str, Any] = yaml.safe_load(spec.example) if spec.example else {}
    if not params:
        params = _params_from_parts(spec, docs, target_example)
    # The alias has the shape already; its parameters have names of their own.
    example = {
        key: value
        for key, value in target_example.items()
        if key not in ("shape", "weight", "params")
    }
    example["func"] = spec.name
    if params:
        example["params"] = params
    text = yaml.safe_dump(example, default_flow_style=True, sort_keys=False, width=10_000)
    return text.strip()


def _params_from_parts(
    spec: AliasSpec, docs: Sequence[TermDoc], target_example: dict[str, Any]
) -> dict[str, Any]:
    """The values that the examples of an alias's target and shapes have for its parameters."""
    target_params = target_example.get("params", {})
    meanings = spec.target.written(target_params)
    target_values = {meaning: target_params[key] for key, meaning in meanings.items()}
    params: dict[str, Any] = {}
    for name, (part, key) in spec.exposed.items():
        values = target_values
        if part > 0:  # part 0 is the target, the others are shapes
            shape_example = yaml.safe_load(docs[part].example)["shape"]
            values = _shape_params(shape_example, spec.steps[part - 1])
        if key in values:
            params[name] = values[key]
    return params


def _shape_params(shape_example: Any, shape: TermSpec) -> dict[str, Any]:
    """Parameters of one shape in an example's `shape`, which is one step or a list of steps."""
    steps = shape_example if isinstance(shape_example, list) else [shape_example]
    for step in steps:
        value = step.get(shape.name) if isinstance(step, dict) else None
        if isinstance(value, dict):
            return value
        if value is not None:  # a shape with one parameter: `linear: 2.0`
            return {next(iter(shape.params)): value}
    return {}


def find_entries(name: str) -> list[TermEntry]:
    """Return the terms and shapes with a name; several if more than one kind has it.

    Raises:
        ConfigError: If there is none; names the closest.
    """
    entries = [*all_entries(), *shape_entries()]
    matching_entries = [entry for entry in entries if entry.name == name]
    if not matching_entries:
        hint = did_you_mean(name, [entry.name for entry in entries])
        raise ConfigError(f"no term is called '{name}'.{hint} `embodichain list terms` lists them.")
    return matching_entries


def _argument(name: str, parameter: inspect.Parameter) -> str:
    """``name`` if the parameter is required, else ``name=default``."""
    if parameter.default is inspect.Parameter.empty:
        return name
    return f"{name}={parameter.default}"


def _default(parameter: inspect.Parameter) -> str:
    """A default as YAML; empty if the parameter is required."""
    value = parameter.default
    if value is inspect.Parameter.empty:
        return ""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, tuple):
        return str(list(value))
    return str(value)


# -- docstrings ------------------------------------------------------------------------------------


@cache
def parse_doc(doc: str) -> TermDoc:
    """Parse a docstring, as `inspect.getdoc` returns it."""
    sections: dict[str, list[str]] = {"": []}
    current = ""
    for line in doc.splitlines():
        header = _SECTION.match(line)
        if header is not None:
            current = header[1]
            sections.setdefault(current, [])
        else:
            sections[current].append(line)
    blocks = re.split(r"\n\s*\n", "\n".join(sections[""]).strip("\n"))
    # Indented paragraphs (formulas, lists) keep their lines.
    paragraphs = [
        block if re.match(r"\s|[*-] ", block) else " ".join(block.split())
        for block in blocks
        if block.strip()
    ]
    return TermDoc(
        summary=paragraphs[0] if paragraphs else "",
        text="\n\n".join(paragraphs),
        params=_entries(sections.get("Args", [])),
        example=" ".join(" ".join(sections.get("Example", [])).split()).strip("`"),
    )


def _entries(lines: list[str]) -> dict[str, str]:
    """``name: text`` entries; deeper indented lines continue the one before."""
    descriptions: dict[str, str] = {}
    name = ""
    for line in textwrap.dedent("\n".join(lines)).splitlines():
        entry = _ENTRY.match(line)
        if entry is not None:
            name = config_word(entry[1])
            descriptions[name] = entry[2].strip()
        elif name and line.strip():
            descriptions[name] += f" {line.strip()}"
    return descriptions


def _description(hint: Any) -> str:
    """The description of a type, which serves every parameter of that type."""
    for part in getattr(hint, "__metadata__", ()):
        text = part if isinstance(part, str) else getattr(part, "description", None)
        if text:
            return text
    for argument in get_args(hint):
        text = _description(argument)
        if text:
            return text
    return ""


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
        hint, *annotations = get_args(hint)
        for annotation in annotations:
            # A pydantic Field has constraints in its own `metadata`.
            metadata += getattr(annotation, "metadata", [annotation])
    origin = get_origin(hint)
    arguments = get_args(hint)
    name = getattr(hint, "__name__", str(hint))
    if origin in (Union, types.UnionType):
        words = " or ".join(dict.fromkeys(map(type_words, arguments)))
    elif origin is Literal:
        words = " or ".join(map(str, arguments))
    elif origin is not None:
        return _container(origin, arguments, metadata)
    elif dataclasses.is_dataclass(hint) and name not in _NAMED:
        names = [field.name.removesuffix("_") for field in dataclasses.fields(hint)]
        words = f"map with {', '.join(names)}"
    else:
        words = _NAMED.get(name) or _WORDS.get(hint, name)
    return f"{words} {_limits(metadata)}".strip()


def _limits(metadata: Sequence[Any]) -> str:
    """The limits of a number: ``> 0 and <= 1``; empty without one."""
    limits = []
    for constraint in metadata:
        for key, sign in _LIMITS.items():
            value = getattr(constraint, key, None)
            if value is not None:
                limits.append(f"{sign} {value:g}")
    return " and ".join(limits)


def _container(origin: Any, arguments: tuple[Any, ...], metadata: list[Any]) -> str:
    """Describe a list or a map; pairs with a further check are bounds."""
    if issubclass(origin, Mapping):
        return f"map of {type_words(arguments[-1])}" if arguments else "map"
    if not issubclass(origin, Iterable):
        return str(origin.__name__)
    item = type_words(arguments[0]) if arguments else "anything"
    min_length = _last_of(metadata, "min_length")
    max_length = _last_of(metadata, "max_length")
    length = min_length if min_length == max_length else None
    if origin is tuple and arguments and arguments[-1] is not Ellipsis:
        has_unlike_items = len(set(map(str, arguments))) > 1
        if has_unlike_items:
            return f"[{', '.join(map(type_words, arguments))}]"
        length = len(arguments)
    if length is None:
        return f"list of {item}, at least {min_length}" if min_length else f"list of {item}"
    has_check = any(hasattr(constraint, "func") for constraint in metadata)
    if length == 2 and has_check:
        return "[low, high]" if item == "number" else f"[low, high], each {item}"
    return f"{length} {item.replace('number', 'numbers', 1)}"


def _last_of(metadata: Sequence[Any], key: str) -> int | None:
    """The last value of a constraint, which replaces those before it; None without one."""
    last = None
    for constraint in metadata:
        value: int | None = getattr(constraint, key, None)
        if value is not None:
            last = value
    return last


# -- the page docs/terms.md -----------------------------------------------------------------------

_BUILTIN = "embodichain."
_QUANTITIES = (
    "Serve observations, rewards, terminations and metrics, except where a line says otherwise."
)
_OTHER_NAMES = """\
`embodichain show term NAME` lists the parameters; those in capitals have another name than in the
term."""


def catalogue() -> str:
    """Return the page. Terms of other packages are not on it."""
    head = resources.files("embodichain.cli") / "templates" / "terms.md.tmpl"
    entries = [entry for entry in all_entries() if _is_builtin(entry)]
    aliases = [entry for entry in entries if _is_plain_alias(entry)]
    described = [entry for entry in entries if not _is_plain_alias(entry)]

    chapters: dict[str, list[TermEntry]] = {
        "quantities": [entry for entry in described if set(entry.kinds) & set(VALUE_KINDS)],
        "shapes": shape_entries(),
    }
    for kind, section in SECTION_OF.items():
        if kind not in VALUE_KINDS:
            chapters[section] = [entry for entry in described if kind in entry.kinds]

    lines = [head.read_text(encoding="utf-8")]
    for title, members in chapters.items():
        lines.append(f"* [{title}](#{title}): {len(members)}")
    lines.append(f"* [other names](#other-names): {len(aliases)}")
    for title, members in chapters.items():
        lines += ["", f"## {title}", ""]
        if title == "quantities":
            lines += [_QUANTITIES, ""]
        for entry in members:
            lines += _describe_term(entry)
    lines += ["", "## other names", "", _OTHER_NAMES, ""]
    lines += _alias_table(aliases)
    return "\n".join(lines).rstrip("\n") + "\n"


def _is_builtin(entry: TermEntry) -> bool:
    return entry.spec.func.__module__.startswith(_BUILTIN)


def _is_plain_alias(entry: TermEntry) -> bool:
    """Whether a term is only another name of a term with shapes."""
    return isinstance(entry.spec, AliasSpec) and not entry.spec.makers


def _alias_table(aliases: Sequence[TermEntry]) -> Iterator[str]:
    """A row for each alias: its name, its sections, its meaning."""
    rows = []
    for entry in aliases:
        meaning = entry.spec.doc.removeprefix("Alias of ").replace("``", "`").rstrip(".")
        rows.append((f"`{entry.name}`", entry.sections, meaning))
    return _rows(("name", "for", "alias of"), rows)


def _describe_term(entry: TermEntry) -> Iterator[str]:
    """The lines about one term: header, description, table of parameters, example."""
    yield from (f"### {entry.name}", "", entry.doc.text, "")
    notes = []
    serves_some_sections = set() < set(entry.kinds) < set(VALUE_KINDS)
    if serves_some_sections:
        notes.append(f"For {entry.sections}.")
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
        yield from _rows(("parameter", "type", "default", "what"), rows)
        yield ""
    if entry.doc.example:
        yield from (f"Example: `{entry.doc.example}`", "")


def _rows(names: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """A table in Markdown."""
    for row in (names, ("---",) * len(names)):
        yield f"| {' | '.join(row)} |"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
