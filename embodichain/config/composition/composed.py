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

from embodichain.config.composition.defaults_lists import place_of_choice
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
from embodichain.config.composition.unlike_values import unlike_in_files, why_not_applied
from embodichain.config.composition.variations import merge_variations
from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import show_value
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    from embodichain.config.composition.gym_config import GymConfig

__all__ = [
    "WITHOUT_TASK",
    "ChosenVariations",
    "Composed",
    "ParsedOverrides",
    "apply_values",
    "compose",
    "compose_variations",
    "from_hydra",
    "list_options",
    "parse",
    "placed_key",
    "plain_values",
    "relax",
    "search_path",
]

_PLACED_GROUPS = {"embodiment": "task"}
"""Group -> the package at which a task's `defaults` place its options, where none is typed."""
_ONE_OPTION_GROUPS = frozenset(
    {"algo", "embodiment", "object", "record", "scene", "sim", "task", "viewer"}
)
"""Groups of which one option is chosen at a place: two would be merged into neither."""
_FOLDERS = ("hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir")
WITHOUT_TASK = "~task"
"""The override that composes a config with no option of the group `task`."""


@dataclass(frozen=True)
class Composed:
    """One composed config, not yet checked.

    Attributes:
        config_name: The root config: ``run``, ``train`` or ``collect``.
        overrides: As typed.
        tree: Plain dicts and lists, interpolations resolved, without Hydra's own node; text of the
            environment is an `EnvText`. Partial if there are problems.
        choices: Group -> the chosen option.
        locator: Finds where each key was set.
        problems: The mistakes found so far.
        usable: Whether `tree` is complete; otherwise it has at most values of the root, and only
            their types can be checked.
        notes: Parts of a gym config that were left out or changed in the conversion, and parts of
            variations that change nothing.
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
        if "." not in path and self.tree.get(path) is None:
            return COMMAND_LINE
        return self.locator.source(path)


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
        config_name: ``run``, ``train`` or ``collect``.
        config_dir: A folder with the user's groups, searched first.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    lines = tuple(overrides)
    places, mistakes = search_path(lines)
    register_resolvers()
    with searched(places), config_loader(config_dir) as loader:
        parsed = parse(lines, loader)
        parsed = replace(parsed, problems=(*mistakes, *parsed.problems))
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
            unspecified = [f"You must specify '{group}'" for group in parsed.broken]
            if any(text in str(error) for text in unspecified):
                return _without_task(loader, config_name, lines, parsed, [])
            mistakes = _unlike_values(error, loader.merged, loader)
            if not mistakes:
                mistakes = explain(error, loader, parsed.for_hydra)
            return _without_task(loader, config_name, lines, parsed, mistakes)
    choices = dict(config.hydra.runtime.choices)
    folders = [folder_of_source(s.schema, s.path) for s in config.hydra.runtime.config_sources]
    try:
        files, of_hydra = _files(loader.merged, folders, gym)
    except yaml.YAMLError as error:  # a tag that Hydra reads
        return _without_task(loader, config_name, lines, parsed, [explain_yaml(error)])
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    base_files = _files_of_whole_options(config, files)
    mistakes = unlike_in_files([*base_files, *files])
    if mistakes:
        return _without_task(loader, config_name, lines, parsed, mistakes)
    _complete_options(config, base_files)
    files = [*base_files, *files]
    if gym is not None:
        choices["task"] = gym.name
        config["task"] = OmegaConf.merge(gym.task, config.get("task", {}))
    problems = [*parsed.problems, *apply_values(config, parsed.values)]
    problems += _lists_of_options(loader.merged, files)
    problems += _misplaced_variations(loader.merged, files)
    locator = Locator(files, parsed.values)
    for file in (*files, *of_hydra):
        problems += file.problems()
    empty = [file for file in files if file.package == "task" and not file.keys]
    for file in empty:
        group = file.path.parent.name
        message = "the file is empty: a task has at least a key"
        if group == _EMBODIMENT:
            message = f"the file is empty: an {group} has at least a robot"
        problems.append(Problem(group, message, source=display_path(file.path)))
    problems += _tasks_of_embodiments(files)
    tree, unresolved = plain_values(config, locator)
    # Hydra leaves out what other files have at the place of an empty one.
    problems += [problem for problem in unresolved if not (empty and problem.path == "task")]
    tree, mistakes = remove_null_entries(tree, locator.gives)
    mistakes += keep_last_given(tree, locator.rank)
    merged = merge_variations(tree, locator.source)
    mistakes += merged.problems
    problems += [problem.at(locator.source(problem.path)) for problem in mistakes]
    locator = replace(locator, origins=merged.origins)
    return Composed(
        config_name=config_name,
        overrides=lines,
        tree=merged.tree,
        choices=choices,
        locator=locator,
        problems=tuple(problems),
        notes=(*parsed.notes, *(gym.notes if gym is not None else ()), *merged.notes),
    )


@dataclass(frozen=True)
class ChosenVariations:
    """Options of the group `variation`, composed without a task.

    Attributes:
        entries: Name -> the variation, as it would be in a task.
        files: Their files, in the order of merging.
    """

    entries: dict[str, Any]
    files: tuple[ConfigFile, ...]


def compose_variations(lines: Sequence[str]) -> ChosenVariations:
    """Compose options of the group `variation` alone, for a task that was composed before.

    Args:
        lines: Their choices, as `parse` returns them for Hydra.

    Raises:
        ConfigError: Their files have mistakes.
    """
    if not lines:
        return ChosenVariations({}, ())
    with config_loader() as loader:
        try:
            config = loader.load_configuration("run", [*lines, WITHOUT_TASK], RunMode.RUN)
        except COMPOSING as error:
            mistakes = _unlike_values(error, loader.merged, loader)
            if not mistakes:
                mistakes = explain(error, loader, lines)
            raise ConfigError(mistakes) from error
    folders = [folder_of_source(s.schema, s.path) for s in config.hydra.runtime.config_sources]
    files, _ = _files(loader.merged, folders, None)
    varying = [file for file in files if file.package.startswith(f"{_VARIATIONS}.")]
    problems = _misplaced_variations(loader.merged, files)
    for file in varying:
        problems += file.problems()
    if problems:
        raise ConfigError(problems)
    entries = OmegaConf.select(config, _VARIATIONS)
    plain: Any = {} if entries is None else OmegaConf.to_container(entries, resolve=False)
    return ChosenVariations(plain, tuple(varying))


def from_hydra() -> Composed:
    """Compose again what Hydra's own `main` composed for the job that is running.

    Raises:
        ValueError: Outside of a Hydra job.
    """
    job = HydraConfig.get()
    sources = [s.path for s in job.runtime.config_sources if s.provider == "--config-dir"]
    typed: Any = OmegaConf.to_container(job.overrides, resolve=False)  # not what they refer to
    return compose(
        [*typed["hydra"], *typed["task"]],
        config_name=job.job.config_name or "run",
        config_dir=sources[0] if sources else None,
    )


def list_options(group: str, config_dir: str | Path | None = None) -> list[str]:
    """Return the sorted options of a group (``task``, ``record``...); empty if it is unknown."""
    with config_loader(config_dir) as loader:
        return list(loader.get_group_options(group))


def _gym_config(parsed: ParsedOverrides) -> tuple[GymConfig | None, ParsedOverrides]:
    """The gym config that overrides name, if any, and overrides that choose no other task."""
    paths = [o.value() for o in parsed.values if o.key_or_group == "gym_config"]
    if not paths or paths[-1] is None:
        return None, parsed
    tasks = [line for line in parsed.for_hydra if line.lstrip("+").startswith("task=")]
    others = [line for line in parsed.for_hydra if line not in tasks and line != WITHOUT_TASK]
    problems = list(parsed.problems)
    if tasks:
        message = f"either a gym config or a task: {tasks[-1]}"
        problems.append(Problem("task", message, source=COMMAND_LINE))
    gym = None
    from embodichain.config.composition.gym_config import load_gym_config  # terms: only when needed

    try:
        gym = load_gym_config(str(paths[-1]))
        problems += gym.problems
    except ConfigError as error:
        problems += [p.at("") for p in error.problems]
    for_hydra = (*others, WITHOUT_TASK)
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
        if path is None:
            continue
        file = ConfigFile.read(path, default.package or "")
        if name.startswith("hydra/"):
            of_hydra.append(file)
        else:
            files.append(file)
    return files, of_hydra


def _lists_of_options(
    merged: Sequence[ResultDefault], files: Sequence[ConfigFile]
) -> list[Problem]:
    """Return a problem for each list of options in a file, of a group that takes one option."""
    options_at: dict[tuple[str | None, str, str | None], list[str]] = {}
    for default in merged:
        group, _, option = (default.config_path or "").rpartition("/")
        is_inherited = (default.parent or "").startswith(f"{group}/")
        if group in _ONE_OPTION_GROUPS and not is_inherited:
            place = (default.parent, group, default.package)
            options_at.setdefault(place, []).append(option)
    problems: list[Problem] = []
    for (_, group, _), options in options_at.items():
        if len(options) > 1:
            message = f"takes one option, got [{', '.join(options)}]"
            source = place_of_choice(files, group, options[-1]) or COMMAND_LINE
            problems.append(Problem(group, message, source=source))
    return problems


def _misplaced_variations(
    merged: Sequence[ResultDefault], files: Sequence[ConfigFile]
) -> list[Problem]:
    """Return a problem for each file of the group `variation` at another place than its own."""
    places: set[tuple[str, str]] = set()
    for default in merged:
        group, _, option = (default.config_path or "").rpartition("/")
        if group == "variation":
            places.add((default.package or "", option))
    problems: list[Problem] = []
    for file in files:
        package = file.package
        if (package, file.path.stem) not in places or package.startswith(f"{_VARIATIONS}."):
            continue
        if package in ("", "task") and _VARIATIONS in file.keys:
            continue  # its keys begin with those of the place
        name = file.path.stem
        message = f"its first line must be `# @package {_VARIATIONS}.{name}`"
        hint = ""
        if package not in ("", "variation"):
            similar = [_VARIATIONS] if package.startswith("task.v") else []
            hint = did_you_mean(package.rpartition(".")[0], similar).strip()
        source = display_path(file.path)
        problems.append(Problem(package or "variation", message, hint, source))
    return problems


def _tasks_of_embodiments(files: Sequence[ConfigFile]) -> list[Problem]:
    """Return a problem for each file of an embodiment that says what only a task says."""
    problems: list[Problem] = []
    for file in files:
        if file.path.parent.name != _EMBODIMENT:
            continue
        package = f"{file.package}." if file.package else ""
        keys = [
            key
            for key in _OF_TASKS
            if (place := file.keys.get(f"{package}{key}")) is not None and place.kind != "null"
        ]
        if keys:
            line = file.keys[f"{package}{keys[0]}"].line
            message = f"it names no object and no task: write {listing(keys)} in a task"
            source = f"{display_path(file.path)}:{line}"
            problems.append(Problem(_EMBODIMENT, message, source=source))
    return problems


_EMBODIMENT = "embodiment"
_OF_TASKS = (
    *("objects", "articulations", "scene", "commands", "rewards", "terminations", "metrics"),
    *("curriculum", "expert", "suggested", "max_episode_steps", "episode_length_s", "variations"),
)
"""Keys of a task that a file of the group `embodiment` has no use for."""
_VARIATIONS = "task.variations"
"""The map of a task's variations."""
_WHOLE_OPTIONS = {"sim": "default", "record": "mcap", "viewer": "none"}
"""Group -> the option of this package over which options of users are merged."""


def _files_of_whole_options(config: DictConfig, files: Sequence[ConfigFile]) -> list[ConfigFile]:
    """The package's options of groups over which users' options are merged."""
    own = own_folder()
    base_files: list[ConfigFile] = []
    for group, option in _WHOLE_OPTIONS.items():
        users = [f for f in files if f.package == group and not f.path.is_relative_to(own)]
        if users and isinstance(config.get(group), DictConfig):
            base_files.append(ConfigFile.read(own / group / f"{option}.yaml", group))
    return base_files


def _complete_options(config: DictConfig, base_files: Sequence[ConfigFile]) -> None:
    """Merge users' options of groups over the package's, in place."""
    for file in base_files:
        config[file.package] = OmegaConf.merge(OmegaConf.load(file.path), config[file.package])


def _unlike_values(
    error: Exception, merged: Sequence[ResultDefault], loader: ConfigLoader
) -> list[Problem]:
    """The maps over lists, and lists over maps, that composing has stopped at."""
    if "ConfigTypeError" not in str(error):
        return []
    folders = [folder_of_source(source.scheme(), source.path) for source in loader.get_sources()]
    try:
        files, _ = _files(merged, folders, None)
    except yaml.YAMLError as malformed:
        return [explain_yaml(malformed)]
    return unlike_in_files(files)


def _without_task(
    loader: ConfigLoader,
    config_name: str,
    lines: tuple[str, ...],
    parsed: ParsedOverrides,
    mistakes: Sequence[Problem],
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
        tree, _ = plain_values(config, locator)
    return Composed(
        config_name=config_name,
        overrides=lines,
        tree=tree,
        choices={},
        locator=locator,
        problems=(*parsed.problems, *mistakes),
        usable=False,
    )


def _algorithm(
    config: DictConfig, values: Sequence[Override], options: Sequence[str]
) -> str | None:
    """The option for `algo: null`: the one named by a key, else the task's suggestion, else ppo.

    A name that is not an option is reported, with its place, by the check of types.
    """
    if config.hydra.runtime.choices.get("algo", "") is not None:
        return None
    names: list[Any] = [o.value() for o in values if o.key_or_group == "algo.name"]
    names.append(OmegaConf.select(config, "algo.name"))
    names.append(OmegaConf.select(config, "task.suggested.train.algo.name"))
    return next((name for name in names if name in options), DEFAULT_ALGORITHM)


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
        prefix = f"{path}." if path else ""
        values: dict[Any, Any] = {}
        for key in range(len(node)) if isinstance(node, ListConfig) else list(node):
            name = names.get(f"{prefix}{key!s}", key)  # as written: `off`, not False
            key_path = f"{prefix}{name!s}"
            if key in _INSTANTIATE:
                report(key_path, f"{key} is not used here: name a function with func: NAME")
                continue
            if OmegaConf.is_missing(node, key):
                report(key_path, "missing value (???): it must be set")
                continue
            try:
                value = value_of(node, key)
            except OmegaConfBaseException as error:
                written: Any = OmegaConf.to_container(node, resolve=False)
                reason = str(error).splitlines()[0]
                report(key_path, f"cannot resolve {written[key]!r}: {reason}")
                continue
            if isinstance(value, (DictConfig, ListConfig)):
                value = plain(value, key_path)
            values[name] = value
        if isinstance(node, ListConfig):
            return list(values.values())
        return {str(name): value for name, value in values.items()}

    return plain(node, ""), problems


@dataclass(frozen=True)
class ParsedOverrides:
    """Overrides sorted by their kind, each kind in the order given.

    Attributes:
        for_hydra: Overrides that choose group options or set keys of Hydra itself.
        values: Overrides that add, change or delete values.
        broken: Groups for which an unknown option was chosen (their overrides are left out).
        problems: The mistakes in the overrides that are left out.
        notes: Choices that count for nothing, because a later one is of the same group.
    """

    for_hydra: tuple[str, ...]
    values: tuple[Override, ...]
    broken: frozenset[str]
    problems: tuple[Problem, ...]
    notes: tuple[Problem, ...] = ()


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
    choices: dict[str, str] = {}  # group with its place -> the last choice, as typed
    notes: list[Problem] = []
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
            message = f"{typed!r} is a sweep: add -m to run every value"
            if key not in _ONE_OPTION_GROUPS:
                message = f"{message}, or write {key}=[...] for a list"
            problems.append(Problem(key, message, source=COMMAND_LINE))
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
                key = placed_key(override)
                notes += _replaced_choice(override, typed, choices.get(key))
                choices[key] = typed
                for_hydra.append(_placed(override, _quote_number(override, line, options)))
            else:
                broken.add(override.key_or_group)
                problems.append(problem)
        else:
            values.append(override)
            problems += _odd_keys(override.value(), override.key_or_group)
    return ParsedOverrides(
        for_hydra=tuple(for_hydra),
        values=tuple(values),
        broken=frozenset(broken),
        problems=tuple(problems),
        notes=tuple(notes),
    )


def _replaced_choice(override: Override, typed: str, earlier: str | None) -> list[Problem]:
    """A note that an earlier choice counts for nothing; none if there is no other one."""
    if earlier is None or earlier == typed or override.is_delete():
        return []
    message = f"{earlier} is not used, because {typed} comes later"
    return [Problem(override.key_or_group, message, source=COMMAND_LINE)]


def search_path(lines: Iterable[str]) -> tuple[list[str], list[Problem]]:
    """Return the places that ``hydra.searchpath=[...]`` names, and its mistakes.

    Args:
        lines: Overrides, as typed; the last one counts.
    """
    matching = [line for line in lines if line.lstrip("+~").partition("=")[0] == SEARCH_PATH]
    if not matching:
        return [], []
    try:
        override = OverridesParser.create().parse_override(readable(matching[-1]))
    except HydraException as error:
        return [], [malformed(matching[-1], error)]
    return search_path_of(override)


def relax(lines: Iterable[str], loader: ConfigLoader) -> list[str]:
    """Write ``key=value`` as ``++key=value``, for Hydra's own `main`, and groups at their places.

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
        is_change = override.type is OverrideType.CHANGE and not _is_hydras(override)
        if is_change and not loader.get_group_options(override.key_or_group):
            line = f"++{line}"
        relaxed.append(_placed(override, line))
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
                continue
            value = override.value()
            if key == "video" and value is True and isinstance(config[key], DictConfig):
                continue  # settings of a film turn it on: `video.every=2 video=true`
            OmegaConf.update(config, key, value, merge=True, force_add=True)
        except KeyError as error:
            problems.append(Problem(key, str(error.args[0]), source=COMMAND_LINE))
        except (OmegaConfBaseException, IndexError, TypeError, ValueError) as error:
            problems.append(why_not_applied(config, override, error))
    return problems


def _delete(config: DictConfig, key: str) -> None:
    parent_key, _, name = key.rpartition(".")
    parent: Any = OmegaConf.select(config, parent_key) if parent_key else config
    if not isinstance(parent, DictConfig) or name not in parent:
        siblings = [str(k) for k in parent] if isinstance(parent, DictConfig) else []
        listed = f"; there are: {', '.join(siblings)}." if siblings else ""
        hint = did_you_mean(name, siblings)
        raise KeyError(f"cannot delete it: there is no such key{listed}{hint}")
    del parent[name]


def _is_folder(value: Any) -> bool:
    return isinstance(value, str | int | float) and str(value).strip() != ""


def _is_hydras(override: Override) -> bool:
    key = override.key_or_group
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def placed_key(override: Override) -> str:
    """Return the key of an override, with a group's package: ``embodiment@task``."""
    group = override.key_or_group
    package = override.package or _PLACED_GROUPS.get(group)
    return group if package is None else f"{group}@{package}"


def _placed(override: Override, line: str) -> str:
    """The choice of an option where tasks place its group: ``embodiment@task=panda``."""
    if override.package is not None:
        return line
    return line.replace(override.key_or_group, placed_key(override), 1)


def _quote_number(override: Override, line: str, options: list[str]) -> str:
    """The choice of an option; a name that is a number (``task=10``) has quotes for Hydra."""
    key, _, name = line.partition("=")
    if isinstance(override.value(), int | float) and name in options:
        return f"{key}='{name}'"
    return line


def _odd_keys(value: Any, path: str) -> Iterator[Problem]:
    """A problem for each key of a typed map that is a flag, a fraction or null: ``{true: 1}``."""
    if isinstance(value, list):
        for i, item in enumerate(value):
            yield from _odd_keys(item, f"{path}.{i}")
    elif isinstance(value, dict):
        for key, item in value.items():
            if key is None or isinstance(key, bool | float):
                shown = show_value(key)
                message = f"the key {shown} is not read as text: write +{path}.{shown}.KEY=VALUE"
                yield Problem(f"{path}.{shown}", message, source=COMMAND_LINE)
            yield from _odd_keys(item, f"{path}.{key}")


def _sweep_of(override: Override) -> str:
    """The sweep over the options of a list: ``-m embodiment=ur10,panda``."""
    key, _, value = (override.input_line or "").partition("=")
    return f"-m {key.lstrip('+')}={value.strip('[] ').replace(' ', '')}"


def _check_option(override: Override, options: list[str]) -> Problem | None:
    """The problem of a choice that is not an option of its group."""
    value = override.value()
    if override.is_delete():
        return None
    typed = (override.input_line or "").partition("=")[2]
    if isinstance(value, int | float) and typed in options:
        return None
    if isinstance(value, list) and override.key_or_group in _ONE_OPTION_GROUPS:
        message = f"takes one option, got {typed}; -m for a sweep: {_sweep_of(override)}"
        return Problem(override.key_or_group, message, source=COMMAND_LINE)
    for option in value if isinstance(value, list) else [value]:
        name = "null" if option is None else str(option)
        if name not in options:
            group = override.key_or_group
            message = f"unknown option {name!r}; {group} is one of: {', '.join(options)}."
            hint = did_you_mean(name, options).strip()
            if group == "task" and (name == "last" or Path(name).is_dir()):
                hint = "A run is taken by eval, play, replay, report, export and compare."
            return Problem(group, message, hint, COMMAND_LINE)
    return None
