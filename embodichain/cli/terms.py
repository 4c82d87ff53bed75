"""Registered terms as people read about them: kinds, parameters with types and defaults, example.

What `list terms`, `show term` and the page docs/terms.md print comes from here. No torch.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.registry import TermSpec

__all__ = [
    "SECTION_OF",
    "TermDoc",
    "TermEntry",
    "all_entries",
    "catalogue",
    "find_entries",
    "parse_doc",
    "type_words",
]

SECTION_OF = {
    "action": "actions",
    "event": "events",
    "command": "commands",
    "observation": "observations",
    "reward": "rewards",
    "termination": "terminations",
    "metric": "metrics",
    "curriculum": "curriculum",
}
"""Kind of term -> section of a task, in the order of pages and tables."""


_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Example|Examples|Note|Yields):\s*$")
_ENTRY = re.compile(r"^\*{0,2}(\w+)(?: \([^)]*\))?: (.*)$")


@dataclass(frozen=True, slots=True)
class TermDoc:
    """A google-style docstring, taken apart.

    Attributes:
        summary: Its first paragraph, on one line.
        text: The paragraphs before the first section, the summary among them.
        params: What each argument is, on one line.
        example: The line of YAML that declares the term; empty if there is none.
    """

    summary: str = ""
    text: str = ""
    params: dict[str, str] = field(default_factory=dict)
    example: str = ""


@dataclass(frozen=True, slots=True)
class TermEntry:
    """One function or class under one name.

    Attributes:
        name: How configs call it.
        kinds: The managers that run it.
        spec: As it is registered under the first of them.
        doc: Its docstring.
    """

    name: str
    kinds: tuple[str, ...]
    spec: TermSpec
    doc: TermDoc

    @property
    def signature(self) -> str:
        """``name(a, b=1)``, as configs see it."""
        return f"{self.name}({', '.join(map(_short, self.spec.params.values()))})"

    def parameters(self) -> list[dict[str, str]]:
        """One row a parameter: name, type with its range, default, what it is."""
        hints = self.spec.hints()
        return [
            {
                "parameter": name,
                "type": type_words(hints[name]),
                "default": _default(parameter),
                "what": self.doc.params.get(name, ""),
            }
            for name, parameter in self.spec.params.items()
        ]

    @property
    def defined(self) -> str:
        """``module:name`` of the function or class."""
        return f"{self.spec.func.__module__}:{self.spec.func.__qualname__}"

    def facts(self) -> dict[str, Any]:
        """Everything about it, for JSON."""
        return {
            "name": self.name,
            "kinds": list(self.kinds),
            "signature": self.signature,
            "parameters": self.parameters(),
            "doc": self.doc.text,
            "example": self.doc.example,
            "defined": self.defined,
        }


def all_entries() -> list[TermEntry]:
    """Every registered term, by section, then by name; one registered twice stands once."""
    from embodichain.lab.gym.envs.managers.registry import TERMS

    found: dict[tuple[str, Any], list[TermSpec]] = {}
    for kind in SECTION_OF:
        for name, spec in sorted(TERMS[kind].items()):  # type: ignore[index]
            found.setdefault((name, spec.func), []).append(spec)
    return [
        TermEntry(name, tuple(s.kind for s in specs), specs[0], parse_doc(specs[0].doc))
        for (name, _), specs in found.items()
    ]


def find_entries(name: str) -> list[TermEntry]:
    """Return what is registered under a name: several where kinds have one each.

    Raises:
        ConfigError: If nothing is; names the closest.
    """
    entries = all_entries()
    found = [entry for entry in entries if entry.name == name]
    if not found:
        hint = did_you_mean(name, [entry.name for entry in entries])
        raise ConfigError(f"no term is called '{name}'.{hint} `embodichain list terms` lists them.")
    return found


def _short(parameter: inspect.Parameter) -> str:
    """``name`` where a value must be given, else ``name=default``."""
    required = parameter.default is inspect.Parameter.empty
    return parameter.name if required else f"{parameter.name}={parameter.default}"


def _default(parameter: inspect.Parameter) -> str:
    """A default as YAML; empty where a value must be given."""
    value = parameter.default
    if value is inspect.Parameter.empty:
        return ""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(list(value)) if isinstance(value, tuple) else str(value)


# -- docstrings ------------------------------------------------------------------------------------


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
            name = entry[1]
            found[name] = entry[2].strip()
        elif name and line.strip():
            found[name] = f"{found[name]} {line.strip()}"
    return found


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
_LIMITS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def type_words(hint: Any) -> str:
    """Return what a value of this type looks like in YAML.

    Args:
        hint: An evaluated annotation: ``Annotated[float, Field(gt=0)]`` gives ``number > 0``.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(arguments[0], list(_flat(arguments[1:])))
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(type_words(one) for one in arguments))
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if origin is not None:
        return _container(origin, arguments, [])
    name = getattr(hint, "__name__", str(hint))
    if name in _NAMED:
        return _NAMED[name]
    if dataclasses.is_dataclass(hint):
        return f"map with {', '.join(field.name for field in dataclasses.fields(hint))}"
    return _WORDS.get(hint, name)


def _flat(metadata: Iterable[Any]) -> Iterator[Any]:
    """Constraints, those inside pydantic's `Field` too."""
    for item in metadata:
        inner = getattr(item, "metadata", None)
        if isinstance(inner, list):
            yield from inner
        else:
            yield item


def _annotated(hint: Any, metadata: list[Any]) -> str:
    if get_origin(hint) is Annotated:
        inner, *more = get_args(hint)
        return _annotated(inner, [*_flat(more), *metadata])
    origin = get_origin(hint)
    if origin is not None and origin not in (Union, types.UnionType, Literal):
        return _container(origin, get_args(hint), metadata)
    limits = [
        f"{sign} {getattr(item, name):g}"
        for item in metadata
        for name, sign in _LIMITS
        if getattr(item, name, None) is not None
    ]
    return " ".join([type_words(hint), " and ".join(limits)]).strip()


def _container(origin: Any, arguments: tuple[Any, ...], metadata: list[Any]) -> str:
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"map of {type_words(arguments[-1])}" if arguments else "map"
    if origin is tuple and arguments and arguments[-1] is not Ellipsis:
        same = len(set(map(str, arguments))) == 1
        words = type_words(arguments[0])
        return _several(len(arguments), words, False) if same else _listed(arguments)
    if not (isinstance(origin, type) and issubclass(origin, Iterable)):
        return str(getattr(origin, "__name__", origin))
    item = type_words(arguments[0]) if arguments else "anything"
    least = _length(metadata, "min_length")
    most = _length(metadata, "max_length")
    if least is not None and least == most:
        return _several(least, item, any(hasattr(m, "func") for m in metadata))
    return f"list of {item}" + (f", at least {least}" if least else "")


def _length(metadata: list[Any], name: str) -> int | None:
    found = [getattr(item, name) for item in metadata if getattr(item, name, None) is not None]
    return int(found[-1]) if found else None


def _several(count: int, item: str, ordered: bool) -> str:
    """Pairs that are checked beyond their length are bounds."""
    if count == 2 and ordered:
        return "[low, high]" if item == "number" else f"[low, high], each {item}"
    return f"{count} {item.replace('number', 'numbers', 1)}"


def _listed(arguments: tuple[Any, ...]) -> str:
    return f"[{', '.join(map(type_words, arguments))}]"


# -- the page docs/terms.md -----------------------------------------------------------------------

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
