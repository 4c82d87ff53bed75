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
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

import yaml

from embodichain.lab.gym.envs.managers.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.registry import (
    SECTIONS,
    SHAPES,
    TERMS,
    VALUE_KINDS,
    Kind,
    TermSpec,
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


@dataclass(frozen=True, slots=True)
class TermEntry:
    """One function or class under one name.

    Attributes:
        name: How configs call it.
        kinds: The managers that run it; none for a shape.
        spec: As it is registered under the first of them.
        doc: Its docstring; of an alias its meaning.
    """

    name: str
    kinds: tuple[Kind, ...]
    spec: TermSpec
    doc: TermDoc

    @property
    def is_alias(self) -> bool:
        """Whether it is another name of a term."""
        return isinstance(self.spec, AliasSpec)

    @property
    def signature(self) -> str:
        """``name(a, b=1)``, as configs see it."""
        return f"{self.name}({', '.join(_short(*item) for item in self.spec.params.items())})"

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

    def facts(self) -> dict[str, Any]:
        """Everything about it, for JSON."""
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
    """Every registered term, by section, then by name; one registered twice stands once."""
    found: dict[tuple[str, Any], list[TermSpec]] = {}
    for kind in SECTION_OF:
        for name, spec in sorted(TERMS[kind].items()):
            found.setdefault((name, spec.func), []).append(spec)
    return [
        TermEntry(name, tuple(cast("Kind", s.kind) for s in specs), specs[0], _doc_of(specs[0]))
        for (name, _), specs in found.items()
    ]


def shape_entries() -> list[TermEntry]:
    """Every shape that a quantity may be given, in the order of their module."""
    TERMS["reward"]  # shapes are registered with the terms
    return [TermEntry(name, (), spec, parse_doc(spec.doc)) for name, spec in SHAPES.items()]


def _doc_of(spec: TermSpec) -> TermDoc:
    return _doc_of_alias(spec) if isinstance(spec, AliasSpec) else parse_doc(spec.doc)


def _doc_of_alias(spec: AliasSpec) -> TermDoc:
    """An alias described by the docstrings of its target and its shapes."""
    docs = [parse_doc(part.doc) for part in spec.parts]
    first: dict[str, Any] = yaml.safe_load(docs[0].example)
    params: dict[str, Any] = yaml.safe_load(spec.example) if spec.example else {}
    for name, (part, key) in spec.exposed.items() if not params else ():
        given = first.get("params", {})
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
    told = docs[: 1 + len(spec.steps)]
    return TermDoc(
        summary=f"{spec.doc} {docs[0].summary}",
        text="\n\n".join([spec.doc, *(doc.summary for doc in told)]),
        params={name: docs[part].params.get(key, "") for name, (part, key) in spec.exposed.items()},
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
    """Return the terms and shapes of a name: several where kinds have one each.

    Raises:
        ConfigError: If nothing is; names the closest.
    """
    entries = [*all_entries(), *shape_entries()]
    found = [entry for entry in entries if entry.name == name]
    if not found:
        hint = did_you_mean(name, [entry.name for entry in entries])
        raise ConfigError(f"no term is called '{name}'.{hint} `embodichain list terms` lists them.")
    return found


def _short(name: str, parameter: inspect.Parameter) -> str:
    """``name`` where a value must be given, else ``name=default``."""
    required = parameter.default is inspect.Parameter.empty
    return name if required else f"{name}={parameter.default}"


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
            name = entry[1].removesuffix("_")  # `from_` is written `from`
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

Made by `embodichain list terms --markdown`: every function that a task can name, with its
parameters and an example that a test builds. `embodichain show term NAME` prints the same on the
terminal. Units are SI and radians unless a line says otherwise; an *entity* is a reference such as
`{uid: ur10, link_names: [ee_link]}`; `[low, high]` bounds are ordered. N is the number of
environments.

A reward, a metric or a termination is one number of each environment: a [quantity](#quantities),
with a [shape](#shapes) where it has several columns or is to become a kernel or a truth. The
section of the task says which of them it is; an observation takes the columns as they are.

```yaml
description: A quantity in each section.
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1]}
objects:
  goal: {shape: {shape_type: Sphere, radius: 0.02}, body_type: static, init_pos: [0.6, 0.3, 1]}
rewards:
  reach:
    func: distance
    shape: {tanh: 0.1}
    params: &pair {from: {uid: ur10, link_names: [ee_link]}, to: {uid: goal}}
  effort: {func: joint_effort, shape: l2, weight: -1.0e-5, params: {of: {uid: ur10}}}
metrics:
  success: {func: distance, shape: {below: 0.05}, params: *pair}
observations:
  qvel: {func: joint_velocity, scale: 0.1, params: {of: {uid: ur10}}}
```

`of`, `from` and `to` may be written `entity_cfg`, `source_entity_cfg` and `target_entity_cfg`, and
the other way round. [Other names](#other-names), which EmbodiChain, Isaac Lab, mjlab and dm_control
use, are aliases of a term, or of a quantity with a shape.
"""
_BUILTIN = "embodichain."
_QUANTITIES = (
    "Serve observations, rewards, terminations and metrics, except where a line says otherwise."
)
_OTHERS = """\
`embodichain show term NAME` lists the parameters; those in capitals have another name than in the
term."""


def catalogue() -> str:
    """Return the page. Terms of other packages are not on it."""
    entries = [e for e in all_entries() if e.spec.func.__module__.startswith(_BUILTIN)]
    aliases = [e for e in entries if isinstance(e.spec, AliasSpec) and not e.spec.makers]
    described = [e for e in entries if e not in aliases]
    values = [e for e in described if set(e.kinds) & set(VALUE_KINDS)]
    lines = [_HEAD]
    parts: dict[str, list[TermEntry]] = {"quantities": values, "shapes": shape_entries()}
    for kind, section in SECTION_OF.items():
        if kind not in VALUE_KINDS:
            parts[section] = [e for e in described if kind in e.kinds]
    lines += [f"* [{title}](#{title}): {len(found)}" for title, found in parts.items()]
    lines.append(f"* [other names](#other-names): {len(aliases)}")
    for title, found in parts.items():
        lines += ["", f"## {title}", ""]
        if title == "quantities":
            lines += [_QUANTITIES, ""]
        for entry in found:
            lines += _term(entry)
    lines += [
        "",
        "## other names",
        "",
        _OTHERS,
        "",
        "| name | for | alias of |",
        "| --- | --- | --- |",
    ]
    for entry in aliases:
        sections = ", ".join(SECTION_OF[kind] for kind in entry.kinds)
        meaning = entry.spec.doc.removeprefix("Alias of ").replace("``", "`").rstrip(".")
        lines.append(f"| `{entry.name}` | {sections} | {meaning} |")
    return "\n".join(lines).rstrip("\n") + "\n"


def _term(entry: TermEntry) -> Iterator[str]:
    yield f"### {entry.name}"
    yield ""
    yield entry.doc.text
    yield ""
    if entry.kinds and set(entry.kinds) <= set(VALUE_KINDS) and len(entry.kinds) < len(VALUE_KINDS):
        yield f"For {', '.join(SECTION_OF[kind] for kind in entry.kinds)}."
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
