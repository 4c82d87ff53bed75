"""Registered terms as people read about them: kinds, parameters with types and defaults, example.

What `list terms`, `show term` and the catalogue print comes from here. No torch.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from embodichain.cli.term_docs import TermDoc, parse_doc
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.registry import TermSpec

__all__ = ["SECTION_OF", "TermEntry", "all_entries", "find_entries"]

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
        from embodichain.cli.type_words import type_words

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
