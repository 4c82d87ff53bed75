"""`alias`: registers a term class under another name, with parameters of its own."""

from __future__ import annotations

import inspect
import re
import typing
from collections.abc import Callable, Iterable, Mapping
from types import UnionType
from typing import Any

from embodichain.lab.gym.envs.managers.registry import Kind, describe_term, register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["alias"]

Convert = Callable[[Any, dict[str, Any]], dict[str, Any]]


def alias(
    kind: Kind,
    name: str,
    target: type[Term],
    summary: str,
    example: str,
    params: Mapping[str, str] | None = None,
    options: Iterable[str] = (),
    defaults: Mapping[str, Any] | None = None,
    hints: Mapping[str, Any] | None = None,
    fixed: Mapping[str, Any] | None = None,
    extra: Mapping[str, tuple[Any, Any, str]] | None = None,
    convert: Convert | None = None,
    caller: str = "",
) -> type[Term]:
    """Register a subclass of a term class that takes other parameters.

    Args:
        kind: The term's kind.
        name: The alias.
        target: The class.
        summary: First line of the alias's documentation.
        example: Its example, one line of YAML.
        params: Its parameter -> the target's, in order; needed unless in `defaults`.
        options: Parameters that keep the target's name and default.
        defaults: Other defaults, by the alias's names.
        hints: Other types, by the alias's names.
        fixed: Values of parameters of the target that the alias lacks.
        extra: Further parameters -> type, default (`inspect.Parameter.empty`: needed) and what it
            is; `convert` handles them.
        convert: Takes the environment and all parameters, by the target's names, and returns what
            the target takes.
        caller: The module that the alias belongs to.
    """
    spec = describe_term(kind, target)
    types, documented = spec.hints(), _arguments(spec.doc)
    renames = {**(params or {}), **{option: option for option in options}}
    defaults, fixed = defaults or {}, fixed or {}
    signature = [inspect.Parameter("env", inspect.Parameter.POSITIONAL_OR_KEYWORD)]
    lines = []
    for new, old in renames.items():
        hint = (hints or {}).get(new, types[old])
        default = defaults.get(new, spec.params[old].default)
        if new in (params or {}) and new not in defaults:
            hint, default = _given(hint), inspect.Parameter.empty
        signature.append(_keyword(new, default, hint))
        lines.append(f"    {new}: {documented[old]}")
    for new, (hint, default, text) in (extra or {}).items():
        signature.append(_keyword(new, default, hint))
        lines.append(f"    {new}: {text}")
    back = {old: new for new, old in renames.items()}
    build: Callable[..., None] = target.__init__

    def __init__(self: Any, env: Any, **values: Any) -> None:
        given = {renames.get(key, key): value for key, value in values.items()}
        given = {**_renamed(defaults, renames), **given, **fixed}
        try:
            build(self, env, **(convert(env, given) if convert else given))
        except ConfigError as error:
            raise ConfigError(_under_own_names(error.problems, back)) from error

    ranges = getattr(target, "drive_ranges", {})
    title = "".join(part.capitalize() for part in name.split("_"))
    members = {
        "__init__": __init__,
        "__doc__": f"{summary}\n\nArgs:\n"
        + "\n".join(lines)
        + f"\n\nExample:\n    ``{example}``\n",
        "__module__": caller or __name__,
        "__qualname__": title,
        "__signature__": inspect.Signature(signature),
        "drive_ranges": {new: ranges[old] for new, old in renames.items() if old in ranges},
    }
    made: type[Term] = type(title, (target,), members)
    return register_term(kind, name=name)(made)


def _keyword(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def _given(hint: Any) -> Any:
    """A type without None."""
    if typing.get_origin(hint) in (typing.Union, UnionType):
        parts = [part for part in typing.get_args(hint) if part is not type(None)]
        return parts[0] if len(parts) == 1 else hint
    return hint


def _renamed(values: Mapping[str, Any], renames: Mapping[str, str]) -> dict[str, Any]:
    return {renames.get(key, key): value for key, value in values.items()}


def _under_own_names(problems: Iterable[Problem], back: Mapping[str, str]) -> list[Problem]:
    """Problems whose paths begin with the alias's parameters."""
    found = []
    for problem in problems:
        head, dot, rest = problem.path.partition(".")
        found.append(Problem(back.get(head, head) + dot + rest, problem.message, problem.hint))
    return found


def _arguments(doc: str) -> dict[str, str]:
    """Parameter -> its text in a docstring's ``Args``."""
    section = re.search(r"^Args:\n((?:    .*\n|\n)*)", doc + "\n", re.MULTILINE)
    entries = re.split(r"^    (?=\w+: )", section.group(1) if section else "", flags=re.MULTILINE)
    pairs = (entry.partition(": ") for entry in entries if entry.strip())
    return {name: text.rstrip() for name, _, text in pairs}
