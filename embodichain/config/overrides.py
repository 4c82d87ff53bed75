"""Hydra's override grammar, without its demand for `+` where the schema already knows the key.

Overrides are parsed one by one, so that every malformed one is reported, and told apart: those that
choose an option of a group, Hydra's own, and values. What a key means is checked elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.locate import COMMAND_LINE, LocatedProblem
from embodichain.utils.suggest import did_you_mean

__all__ = ["ParsedOverrides", "apply_values", "parse", "relax"]


@dataclass(frozen=True)
class ParsedOverrides:
    """Overrides by what they do, in the order given.

    Attributes:
        for_hydra: The lines that choose group options or are about Hydra itself.
        values: Those that add, change or delete values.
        broken: Groups whose chosen option does not exist (their overrides are left out).
        problems: What is wrong with the ones left out.
    """

    for_hydra: tuple[str, ...]
    values: tuple[Override, ...]
    broken: frozenset[str]
    problems: tuple[LocatedProblem, ...]


def parse(lines: Sequence[str], loader: ConfigLoader) -> ParsedOverrides:
    """Parse overrides; malformed ones, sweeps and unknown options become problems.

    Args:
        lines: As typed: ``key=value``, ``+key=value``, ``~key``, ``group=option``.
        loader: Knows the groups and their options.
    """
    parser = OverridesParser.create()
    for_hydra: list[str] = []
    values: list[Override] = []
    broken: set[str] = set()
    problems: list[LocatedProblem] = []
    for line in lines:
        try:
            override = parser.parse_override(line)
        except HydraException as error:
            problems.append(_malformed(line, error))
            continue
        if not override.key_or_group:
            problems.append(_malformed(line, HydraException("the key is missing")))
        elif override.is_sweep_override():
            problems.append(_sweep(override))
        elif _is_hydras(override):
            for_hydra.append(line)
        elif options := loader.get_group_options(override.key_or_group):
            problem = _check_option(override, options)
            if problem is None:
                for_hydra.append(line)
            else:
                broken.add(override.key_or_group)
                problems.append(problem)
        else:
            values.append(override)
    return ParsedOverrides(tuple(for_hydra), tuple(values), frozenset(broken), tuple(problems))


def relax(lines: Iterable[str], loader: ConfigLoader) -> list[str]:
    """Write ``key=value`` as ``++key=value``, for Hydra's own `main`.

    Hydra refuses to set a key that no file spells out; here defaults live in the data classes.
    Lines it cannot parse are left for Hydra to refuse. Doing it twice changes nothing.
    """
    parser = OverridesParser.create()
    relaxed: list[str] = []
    for line in lines:
        try:
            override = parser.parse_override(line)
        except HydraException:
            relaxed.append(line)
            continue
        plain = override.type is OverrideType.CHANGE and not _is_hydras(override)
        value = plain and not loader.get_group_options(override.key_or_group)
        relaxed.append(f"++{line}" if value else line)
    return relaxed


def apply_values(config: DictConfig, overrides: Iterable[Override]) -> list[LocatedProblem]:
    """Apply value overrides in place, in order; dicts merge, lists replace.

    Returns:
        What could not be applied: deleting what is not there, a key below a value.
    """
    problems: list[LocatedProblem] = []
    for override in overrides:
        key = override.key_or_group
        try:
            if override.is_delete():
                _delete(config, key)
            else:
                OmegaConf.update(config, key, override.value(), merge=True, force_add=True)
        except KeyError as error:
            problems.append(LocatedProblem(key, str(error.args[0]), source=COMMAND_LINE))
        except (OmegaConfBaseException, TypeError, ValueError) as error:
            message = f"cannot apply {override.input_line}: {str(error).splitlines()[0]}"
            problems.append(LocatedProblem(key, message, source=COMMAND_LINE))
    return problems


def _delete(config: DictConfig, key: str) -> None:
    parent_key, _, name = key.rpartition(".")
    parent: Any = OmegaConf.select(config, parent_key) if parent_key else config
    if not isinstance(parent, DictConfig) or name not in parent:
        siblings = [str(k) for k in parent] if isinstance(parent, DictConfig) else []
        there = f"; there are: {', '.join(siblings)}." if siblings else ""
        hint = did_you_mean(name, siblings)
        raise KeyError(f"cannot delete it: there is no such key{there}{hint}")
    del parent[name]


def _is_hydras(override: Override) -> bool:
    key = override.key_or_group
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def _malformed(line: str, error: HydraException) -> LocatedProblem:
    reason = str(error).splitlines()[0]
    message = f"malformed override {line!r}: {reason}; expected key=value, +key=value or ~key"
    return LocatedProblem("", message, source=COMMAND_LINE)


def _sweep(override: Override) -> LocatedProblem:
    message = (
        f"{override.input_line!r} is a sweep: add -m to run every value, or write "
        f"{override.key_or_group}=[...] for a list"
    )
    return LocatedProblem(override.key_or_group, message, source=COMMAND_LINE)


def _check_option(override: Override, options: list[str]) -> LocatedProblem | None:
    value = override.value()
    chosen = value if isinstance(value, list) else [value]
    if override.is_delete():
        return None
    for option in chosen:
        name = "null" if option is None else str(option)
        if name not in options:
            group = override.key_or_group
            message = f"unknown option {name!r}; {group} is one of: {', '.join(options)}."
            hint = did_you_mean(name, options).strip()
            return LocatedProblem(group, message, hint, COMMAND_LINE)
    return None
