"""Registered terms as people read about them: kinds, parameters with types and defaults, example.

What `list terms`, `show term` and the catalogue print comes from here. No torch.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any, cast

import yaml

from embodichain.cli.term_docs import TermDoc, parse_doc
from embodichain.cli.type_words import type_words
from embodichain.lab.gym.envs.managers.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.registry import (
    SECTIONS,
    SHAPES,
    TERMS,
    Kind,
    TermSpec,
)
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["SECTION_OF", "TermEntry", "all_entries", "find_entries", "shape_entries"]

SECTION_OF: dict[Kind, str] = {kind: section for section, kind in SECTIONS.items()}
"""Kind of term -> section of a task, in the order of pages and tables."""


@dataclass(frozen=True, slots=True)
class TermEntry:
    """One function or class under one name.

    Attributes:
        name: How configs call it.
        kinds: The managers that run it; none for a shape.
        spec: As it is registered under the first of them.
        doc: Its docstring; of an alias what it stands for.
    """

    name: str
    kinds: tuple[Kind, ...]
    spec: TermSpec
    doc: TermDoc

    @property
    def is_alias(self) -> bool:
        """Whether it stands for a quantity with a shape."""
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
    """What an alias stands for, in the words of its quantity and its shapes."""
    docs = [parse_doc(part.doc) for part in (spec.target, *spec.steps)]
    examples: list[dict[str, Any]] = [yaml.safe_load(doc.example) for doc in docs]
    example: dict[str, Any] = {"func": spec.name}
    params: dict[str, Any] = {}
    for name, (part, key) in spec.exposed.items():
        given = examples[0].get("params", {})
        if part:
            given = _parameters_of(examples[part]["shape"], spec.steps[part - 1])
        if key in given:
            params[name] = given[key]
    if params:
        example["params"] = params
    text = yaml.safe_dump(example, default_flow_style=True, sort_keys=False, width=10_000)
    return TermDoc(
        summary=f"{spec.doc} {docs[0].summary}",
        text="\n\n".join([spec.doc, *(doc.summary for doc in docs)]),
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
