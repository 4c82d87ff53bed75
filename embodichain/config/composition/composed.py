"""Composes groups, experiments and overrides into one plain tree, merged by Hydra.

Overrides are in Hydra's grammar, but keys of the schema need no `+`. They are parsed one by one and
sorted into choices of a group's option, overrides of Hydra itself, and values. Mistakes are
collected, so that one report lists all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from hydra.core.config_loader import ConfigLoader
from hydra.core.default_element import ResultDefault
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.composition.environment import register_env_resolvers, value_of
from embodichain.config.composition.given_last import keep_last_given
from embodichain.config.composition.hydra_loader import (
    COMPOSING,
    SEARCH_PATH,
    config_loader,
    explain,
    explain_yaml,
    folder_of_source,
    own_folder,
    register_resolvers,
    search_path_of,
    searched,
)
from embodichain.config.composition.locate import COMMAND_LINE, ConfigFile, Locator, display_path
from embodichain.config.composition.override_text import malformed, readable
from embodichain.config.composition.removed_entries import remove_null_entries
from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import show_value
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.config.composition.gym_config import GymConfig

__all__ = [
    "WITHOUT_TASK",
    "Composed",
    "ParsedOverrides",
    "apply_values",
    "compose",
    "from_hydra",
    "list_options",
    "parse",
    "plain_values",
    "relax",
    "search_path",
]

_FOLDERS = ("hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir")
WITHOUT_TASK = "~task"
"""The override that composes a config with no option of the group `task`."""


@dataclass(frozen=True)
class Composed:
    """One composed config, not yet checked.

    Attributes:
        config_name: The root config, ``run`` or ``train``.
        overrides: As typed.
        tree: Plain dicts and lists, interpolations resolved, without Hydra's own node; text of the
            environment is an `EnvText`. Partial if there are problems.
        choices: Group -> the chosen option.
        locator: Finds where each key was set.
        problems: The mistakes found so far.
        usable: Whether `tree` is complete; otherwise it has at most values of the root, and only
            their types can be checked.
        notes: What was left out or changed in converting a gym config.
    """

    config_name: str
    overrides: tuple[str, ...]
    tree: dict[str, Any]
    choices: Mapping[str, str | None]
    locator: Locator
    problems: tuple[Problem, ...] = ()
    usable: bool = True
    notes: tuple[Problem, ...] = ()

    def source(self, path: str) -> str:
        """Return where a key was set: ``FILE:LINE``, or the command line (also for null keys)."""
        unset = "." not in path and self.tree.get(path) is None
        return COMMAND_LINE if unset else self.locator.source(path)


def compose(
    overrides: Sequence[str] = (),
    config_name: str = "run",
    config_dir: str | Path | None = None,
) -> Composed:
    """Compose a root config with overrides in Hydra's grammar; Hydra's global state is unchanged.

    ``key=value`` may set any key of the schema, whether or not a file has it. With
    ``gym_config=FILE`` the task is converted from EmbodiChain's gym config in that file.

    Args:
        overrides: E.g. ``["task=reach", "num_envs=64", "~task.events.push"]``.
        config_name: ``run`` or ``train``.
        config_dir: A folder with the user's groups, searched first.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    lines = tuple(overrides)
    places, wrong = search_path(lines)
    register_resolvers()
    with searched(places), config_loader(config_dir) as loader:
        parsed = parse(lines, loader)
        parsed = replace(parsed, problems=(*wrong, *parsed.problems))
        gym, parsed = _gym_config(parsed)
        if gym is None and WITHOUT_TASK in parsed.for_hydra:
            return _without_task(loader, config_name, lines, parsed, [])
        try:
            lines_of_groups = list(parsed.for_hydra)
            config = loader.load_configuration(config_name, lines_of_groups, RunMode.RUN)
            chosen = _algorithm(config, parsed.values, loader.get_group_options("algo"))
            if chosen is not None:  # the group is null: load its default
                lines_of_groups.append(f"algo={chosen}")
                config = loader.load_configuration(config_name, lines_of_groups, RunMode.RUN)
        except COMPOSING as error:
            # A group without an option is a consequence of leaving out its wrong one.
            known = any(f"You must specify '{group}'" in str(error) for group in parsed.broken)
            found = [] if known else explain(error, loader)
            return _without_task(loader, config_name, lines, parsed, found)
    choices = dict(config.hydra.runtime.choices)
    folders = [folder_of_source(s.schema, s.path) for s in config.hydra.runtime.config_sources]
    try:
        files, of_hydra = _files(loader.merged, folders, gym)
    except yaml.YAMLError as error:  # a tag that Hydra reads
        return _without_task(loader, config_name, lines, parsed, [explain_yaml(error)])
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    files = [*_complete_options(config, files), *files]
    if gym is not None:
        choices["task"] = gym.name
        config["task"] = OmegaConf.merge(gym.task, config.get("task", {}))
    problems = (*parsed.problems, *apply_values(config, parsed.values))
    locator = Locator(files, parsed.values)
    problems += tuple(p for file in (*files, *of_hydra) for p in file.problems())
    problems += tuple(
        Problem("task", "the file is empty: a task has at least a key", source=display_path(f.path))
        for f in files
        if f.package == "task" and not f.keys
    )
    tree, unresolved = plain_values(config, locator)
    tree, kept = remove_null_entries(tree, locator.gives)
    kept += keep_last_given(tree, locator.rank)
    problems = (*problems, *unresolved, *(p.at(locator.source(p.path)) for p in kept))
    notes = gym.notes if gym is not None else ()
    return Composed(config_name, lines, tree, choices, locator, problems, notes=notes)


def from_hydra() -> Composed:
    """Compose again what Hydra's own `main` composed for the job that is running.

    Raises:
        ValueError: Outside of a Hydra job.
    """
    job = HydraConfig.get()
    sources = [s.path for s in job.runtime.config_sources if s.provider == "--config-dir"]
    typed: Any = OmegaConf.to_container(job.overrides, resolve=False)  # not what they refer to
    lines = [*typed["hydra"], *typed["task"]]
    return compose(lines, job.job.config_name or "run", sources[0] if sources else None)


def list_options(group: str, config_dir: str | Path | None = None) -> list[str]:
    """Return the sorted options of a group (``task``, ``record``...); empty if it is unknown."""
    with config_loader(config_dir) as loader:
        return list(loader.get_group_options(group))


def _gym_config(parsed: ParsedOverrides) -> tuple[GymConfig | None, ParsedOverrides]:
    """The gym config that overrides name, if any, and overrides that choose no other task."""
    paths = [o.value() for o in parsed.values if o.key_or_group == "gym_config"]
    if not paths or paths[-1] is None:
        return None, parsed
    chosen = [line for line in parsed.for_hydra if line.lstrip("+").startswith("task=")]
    rest = [line for line in parsed.for_hydra if line not in chosen and line != WITHOUT_TASK]
    problems = list(parsed.problems)
    if chosen:
        message = f"either a gym config or a task: {chosen[-1]}"
        problems.append(Problem("task", message, source=COMMAND_LINE))
    gym = None
    from embodichain.config.composition.gym_config import load_gym_config  # terms: only when needed

    try:
        gym = load_gym_config(str(paths[-1]))
        problems += gym.problems
    except ConfigError as error:
        problems += [p.at("") for p in error.problems]
    for_hydra = (*rest, WITHOUT_TASK)
    return gym, replace(parsed, for_hydra=for_hydra, problems=tuple(problems))


def _files(
    merged: Sequence[ResultDefault],
    folders: Sequence[Path | None],
    gym: GymConfig | None,
) -> tuple[list[ConfigFile], list[ConfigFile]]:
    """The files of a config in the order of merging, and the user's files for Hydra itself."""
    files = [] if gym is None else [gym.file]
    of_hydra: list[ConfigFile] = []
    for default in merged:
        name = default.config_path
        if name is None:
            continue
        paths = [folder / f"{name}.yaml" for folder in folders if folder is not None]
        path = next((p for p in paths if p.is_file()), None)
        if path is not None:
            kind = of_hydra if name.startswith("hydra/") else files
            kind.append(ConfigFile.read(path, default.package or ""))
    return files, of_hydra


_WHOLE_OPTIONS = {"sim": "default", "record": "mcap", "viewer": "none"}
"""Group -> the option of this package over which options of users are merged."""


def _complete_options(config: DictConfig, files: Sequence[ConfigFile]) -> list[ConfigFile]:
    """Merge users' options of groups over the package's, in place; return the files below them."""
    own = own_folder()
    below: list[ConfigFile] = []
    for group, option in _WHOLE_OPTIONS.items():
        theirs = [f for f in files if f.package == group and not f.path.is_relative_to(own)]
        path = own / group / f"{option}.yaml"
        if theirs and isinstance(config.get(group), DictConfig):
            config[group] = OmegaConf.merge(OmegaConf.load(path), config[group])
            below.append(ConfigFile.read(path, group))
    return below


def _without_task(
    loader: ConfigLoader,
    config_name: str,
    lines: tuple[str, ...],
    parsed: ParsedOverrides,
    found: Sequence[Problem],
) -> Composed:
    """The values of the root with their overrides, for when task and groups cannot be composed."""
    values = [o for o in parsed.values if o.key_or_group.split(".")[0] != "task"]
    locator = Locator((), values)
    tree: dict[str, Any] = {}
    with suppress(*COMPOSING):
        config = loader.load_configuration(config_name, ["~task"], RunMode.RUN)
        OmegaConf.set_struct(config, False)
        del config["hydra"]
        apply_values(config, values)
        tree = plain_values(config, locator)[0]
    problems = (*parsed.problems, *found)
    return Composed(config_name, lines, tree, {}, locator, problems, usable=False)


def _algorithm(
    config: DictConfig, values: Sequence[Override], options: Sequence[str]
) -> str | None:
    """The option for `algo: null`: the one named by a key, else the task's suggestion, else ppo.

    A name that is not an option is reported, with its place, by the check of types.
    """
    if config.hydra.runtime.choices.get("algo", "") is not None:
        return None
    named = [o.value() for o in values if o.key_or_group == "algo.name"]
    suggested = OmegaConf.select(config, "task.suggested.train.algo.name")
    written = OmegaConf.select(config, "algo.name")
    return next((n for n in (*named, written, suggested) if n in options), DEFAULT_ALGORITHM)


_INSTANTIATE = ("_target_", "_recursive_", "_convert_", "_partial_", "_args_")


def plain_values(node: DictConfig | ListConfig, locator: Locator) -> tuple[Any, list[Problem]]:
    """Return a config as plain values without unresolvable keys, and a problem for each such key.

    Args:
        node: The config; `EnvText` stands for text of the environment.
        locator: Finds where each key was set.
    """
    register_env_resolvers()
    problems: list[Problem] = []
    names = locator.names()

    def report(path: str, message: str) -> None:
        problems.append(Problem(path, message, source=locator.source(path)))

    def plain(node: DictConfig | ListConfig, path: str) -> Any:
        found: dict[Any, Any] = {}
        for key in range(len(node)) if isinstance(node, ListConfig) else list(node):
            where = f"{path}.{key!s}" if path else str(key)
            name = names.get(where, key)  # as written: `off`, not False
            where = f"{path}.{name!s}" if path else str(name)
            if key in _INSTANTIATE:
                report(where, f"{key} is not used here: name a function with func: NAME")
                continue
            if OmegaConf.is_missing(node, key):
                report(where, "missing value (???): it must be set")
                continue
            try:
                value = value_of(node, key)
            except OmegaConfBaseException as error:
                written: Any = OmegaConf.to_container(node, resolve=False)
                reason = str(error).splitlines()[0]
                report(where, f"cannot resolve {written[key]!r}: {reason}")
                continue
            nested = isinstance(value, (DictConfig, ListConfig))
            found[name] = plain(value, where) if nested else value
        if isinstance(node, ListConfig):
            return list(found.values())
        return {str(key): value for key, value in found.items()}

    return plain(node, ""), problems


@dataclass(frozen=True)
class ParsedOverrides:
    """Overrides sorted by their kind, each kind in the order given.

    Attributes:
        for_hydra: Overrides that choose group options or set keys of Hydra itself.
        values: Overrides that add, change or delete values.
        broken: Groups for which an unknown option was chosen (their overrides are left out).
        problems: The mistakes in the overrides that are left out.
    """

    for_hydra: tuple[str, ...]
    values: tuple[Override, ...]
    broken: frozenset[str]
    problems: tuple[Problem, ...]


def parse(lines: Sequence[str], loader: ConfigLoader) -> ParsedOverrides:
    """Parse overrides; malformed ones, sweeps and unknown options become problems.

    Args:
        lines: As typed: ``key=value``, ``+key=value``, ``~key``, ``group=option``.
        loader: Provides the groups and their options.
    """
    parser = OverridesParser.create()
    for_hydra: list[str] = []
    values: list[Override] = []
    broken: set[str] = set()
    problems: list[Problem] = []
    for typed in lines:
        line = readable(typed)
        try:
            override = parser.parse_override(line)
        except HydraException as error:
            problems.append(malformed(typed, error))
            group = line.lstrip("+~").partition("=")[0]
            if loader.get_group_options(group):
                broken.add(group)
            continue
        if not override.key_or_group:
            problems.append(malformed(line, "the key is missing"))
        elif override.is_sweep_override():
            key = override.key_or_group
            message = f"{typed!r} is a sweep: add -m to run every value, or write {key}=[...]"
            problems.append(Problem(key, f"{message} for a list", source=COMMAND_LINE))
        elif override.key_or_group == SEARCH_PATH:
            continue  # searched already, see `search_path`
        elif override.key_or_group in _FOLDERS and not _is_folder(override.value()):
            message = f"expected the name of a folder, got {show_value(override.value())}"
            problems.append(Problem(override.key_or_group, message, source=COMMAND_LINE))
        elif _is_hydras(override):
            for_hydra.append(line)
        elif options := loader.get_group_options(override.key_or_group):
            problem = _check_option(override, options)
            if problem is None:
                for_hydra.append(_as_text(override, line, options))
            else:
                broken.add(override.key_or_group)
                problems.append(problem)
        else:
            values.append(override)
            problems += _odd_keys(override.value(), override.key_or_group)
    return ParsedOverrides(tuple(for_hydra), tuple(values), frozenset(broken), tuple(problems))


def search_path(lines: Iterable[str]) -> tuple[list[str], list[Problem]]:
    """Return the places that ``hydra.searchpath=[...]`` names, and what is wrong in it.

    Args:
        lines: Overrides, as typed; the last one counts.
    """
    found = [line for line in lines if line.lstrip("+~").partition("=")[0] == SEARCH_PATH]
    if not found:
        return [], []
    try:
        override = OverridesParser.create().parse_override(readable(found[-1]))
    except HydraException as error:
        return [], [malformed(found[-1], error)]
    return search_path_of(override)


def relax(lines: Iterable[str], loader: ConfigLoader) -> list[str]:
    """Write ``key=value`` as ``++key=value``, for Hydra's own `main`.

    Hydra refuses to set a key that no file has; here the defaults are in the data classes. Lines
    that cannot be parsed are left for Hydra to refuse. The function is idempotent.
    """
    parser = OverridesParser.create()
    relaxed: list[str] = []
    for line in map(readable, lines):
        try:
            override = parser.parse_override(line)
        except HydraException:
            relaxed.append(line)
            continue
        plain = override.type is OverrideType.CHANGE and not _is_hydras(override)
        value = plain and not loader.get_group_options(override.key_or_group)
        relaxed.append(f"++{line}" if value else line)
    return relaxed


def apply_values(config: DictConfig, overrides: Iterable[Override]) -> list[Problem]:
    """Apply value overrides in place, in order; dicts merge, lists replace.

    Returns:
        Overrides that could not be applied: deletion of a missing key, a key below a scalar.
    """
    problems: list[Problem] = []
    for override in overrides:
        key = override.key_or_group
        try:
            if override.is_delete():
                _delete(config, key)
            elif (
                key == "video" and override.value() is True and isinstance(config[key], DictConfig)
            ):
                continue  # settings of a film turn it on: `video.every=2 video=true`
            else:
                OmegaConf.update(config, key, override.value(), merge=True, force_add=True)
        except KeyError as error:
            problems.append(Problem(key, str(error.args[0]), source=COMMAND_LINE))
        except (OmegaConfBaseException, TypeError, ValueError) as error:
            message = f"cannot apply {override.input_line}: {str(error).splitlines()[0]}"
            problems.append(Problem(key, message, source=COMMAND_LINE))
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


def _is_folder(value: Any) -> bool:
    return isinstance(value, str | int | float) and str(value).strip() != ""


def _is_hydras(override: Override) -> bool:
    key = override.key_or_group
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def _as_text(override: Override, line: str, options: list[str]) -> str:
    """The choice of an option whose name is a number (``task=10``), with quotes for Hydra."""
    key, _, name = line.partition("=")
    quoted = isinstance(override.value(), int | float) and name in options
    return f"{key}='{name}'" if quoted else line


def _odd_keys(value: Any, path: str) -> Iterator[Problem]:
    """A problem for each key of a typed map that is a flag or no whole number: ``{true: 1}``."""
    if isinstance(value, list):
        for i, item in enumerate(value):
            yield from _odd_keys(item, f"{path}.{i}")
    elif isinstance(value, dict):
        for key, item in value.items():
            if key is None or isinstance(key, bool | float):
                where = f"{path}.{show_value(key)}"
                message = f"the key {show_value(key)} is read as no text: write +{where}.KEY=VALUE"
                yield Problem(where, message, source=COMMAND_LINE)
            yield from _odd_keys(item, f"{path}.{key}")


def _check_option(override: Override, options: list[str]) -> Problem | None:
    value = override.value()
    chosen = value if isinstance(value, list) else [value]
    if override.is_delete():
        return None
    typed = (override.input_line or "").partition("=")[2]
    if isinstance(value, int | float) and typed in options:
        return None
    for option in chosen:
        name = "null" if option is None else str(option)
        if name not in options:
            group = override.key_or_group
            message = f"unknown option {name!r}; {group} is one of: {', '.join(options)}."
            hint = did_you_mean(name, options).strip()
            if group == "task" and (name == "last" or Path(name).is_dir()):
                hint = "A run is taken by eval, play, replay, report, export and compare."
            return Problem(group, message, hint, COMMAND_LINE)
    return None
