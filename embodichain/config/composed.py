"""Groups, experiments and overrides become one plain tree; Hydra does the merging.

Mistakes are collected, not raised, so that they stand in one report with those of `validate`.
Nothing here knows what a key means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.algorithms import DEFAULT_ALGORITHM
from embodichain.config.hydra_errors import COMPOSING, explain
from embodichain.config.locate import COMMAND_LINE, ConfigFile, LocatedProblem, Locator
from embodichain.config.overrides import ParsedOverrides, apply_values, parse
from embodichain.config.search_path import config_loader, folder_of_source
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.gym_config import GymConfig

__all__ = ["WITHOUT_TASK", "Composed", "compose", "from_hydra", "list_options"]

WITHOUT_TASK = "~task"
"""The override that composes a config with no option of the group `task`."""


@dataclass(frozen=True)
class Composed:
    """One composed config, not yet checked.

    Attributes:
        config_name: The root config, ``run`` or ``train``.
        overrides: As typed.
        tree: Plain dicts and lists, interpolations resolved, without Hydra's own node. Partial when
            there are problems.
        choices: The option of each group.
        locator: Where each key was set.
        problems: What went wrong so far.
        usable: Whether `tree` is whole; otherwise its values besides the task are there at best,
            and only their types can be checked.
        notes: What of a gym config was left out or is read otherwise.
    """

    config_name: str
    overrides: tuple[str, ...]
    tree: dict[str, Any]
    choices: Mapping[str, str | None]
    locator: Locator
    problems: tuple[LocatedProblem, ...] = ()
    usable: bool = True
    notes: tuple[LocatedProblem, ...] = ()


def compose(
    overrides: Sequence[str] = (),
    config_name: str = "run",
    config_dir: str | Path | None = None,
) -> Composed:
    """Compose a root config with overrides in Hydra's grammar; Hydra's global state is kept.

    ``key=value`` may set any key of the schema, whether or not a file spells it out. With
    ``gym_config=FILE`` the task is what EmbodiChain's gym config in that file converts to.

    Args:
        overrides: E.g. ``["task=reach", "num_envs=64", "~task.events.push"]``.
        config_name: ``run`` or ``train``.
        config_dir: A folder with groups of the user's own, searched first.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    lines = tuple(overrides)
    with config_loader(config_dir) as loader:
        parsed = parse(lines, loader)
        gym, parsed = _gym_config(parsed)
        if gym is None and WITHOUT_TASK in parsed.for_hydra:
            tree, locator = _partial(loader, config_name, parsed)
            return Composed(config_name, lines, tree, {}, locator, parsed.problems, usable=False)
        try:
            lines_of_groups = list(parsed.for_hydra)
            config = loader.load_configuration(config_name, lines_of_groups, RunMode.RUN)
            chosen = _algorithm(config, parsed.values, loader.get_group_options("algo"))
            if chosen is not None:  # the group was left at null: load what it means
                lines_of_groups.append(f"algo={chosen}")
                config = loader.load_configuration(config_name, lines_of_groups, RunMode.RUN)
        except COMPOSING as error:
            found = [] if _follows(error, parsed) else explain(error, loader)
            problems = (*parsed.problems, *found)
            tree, locator = _partial(loader, config_name, parsed)
            return Composed(config_name, lines, tree, {}, locator, problems, usable=False)
    choices = dict(config.hydra.runtime.choices)
    folders = [folder_of_source(s.schema, s.path) for s in config.hydra.runtime.config_sources]
    files = partial(_files, loader, config_name, lines_of_groups, folders, gym)
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    if gym is not None:
        choices["task"] = gym.name
        config["task"] = OmegaConf.merge(gym.task, config.get("task", {}))
    problems = (*parsed.problems, *apply_values(config, parsed.values))
    locator = Locator(files, parsed.values)
    tree, unresolved = _plain(config, locator)
    problems = (*problems, *unresolved)
    notes = gym.notes if gym is not None else ()
    return Composed(config_name, lines, tree, choices, locator, problems, notes=notes)


def from_hydra() -> Composed:
    """Compose again what Hydra's own `main` composed for the job that is running.

    Raises:
        ValueError: Outside of a Hydra job.
    """
    job = HydraConfig.get()
    sources = [s.path for s in job.runtime.config_sources if s.provider == "--config-dir"]
    lines = [*job.overrides.hydra, *job.overrides.task]
    return compose(lines, job.job.config_name or "run", sources[0] if sources else None)


def list_options(group: str, config_dir: str | Path | None = None) -> list[str]:
    """Return the options of a group (``task``, ``record``...), sorted; empty for no such group."""
    with config_loader(config_dir) as loader:
        return list(loader.get_group_options(group))


def _gym_config(parsed: ParsedOverrides) -> tuple[GymConfig | None, ParsedOverrides]:
    """The gym config that overrides name, if any, and overrides that choose no task beside it."""
    paths = [o.value() for o in parsed.values if o.key_or_group == "gym_config"]
    if not paths or paths[-1] is None:
        return None, parsed
    chosen = [line for line in parsed.for_hydra if line.lstrip("+").startswith("task=")]
    rest = [line for line in parsed.for_hydra if line not in chosen and line != WITHOUT_TASK]
    problems = list(parsed.problems)
    if chosen:
        message = f"either a gym config or a task: {chosen[-1]}"
        problems.append(LocatedProblem("task", message, source=COMMAND_LINE))
    gym = None
    from embodichain.config.gym_config import load_gym_config  # terms: only when needed

    try:
        gym = load_gym_config(str(paths[-1]))
        problems += gym.problems
    except ConfigError as error:
        problems += [LocatedProblem.of(p, "") for p in error.problems]
    for_hydra = (*rest, WITHOUT_TASK)
    return gym, replace(parsed, for_hydra=for_hydra, problems=tuple(problems))


def _files(
    loader: ConfigLoader,
    config_name: str,
    for_hydra: list[str],
    folders: Sequence[Path | None],
    gym: GymConfig | None,
) -> list[ConfigFile]:
    """The files behind a config in the order of merging, without Hydra's own."""
    files = [] if gym is None else [gym.file]
    for default in loader.compute_defaults_list(config_name, for_hydra, RunMode.RUN).defaults:
        name = default.config_path
        if name is None or name.startswith("hydra/"):
            continue
        paths = [folder / f"{name}.yaml" for folder in folders if folder is not None]
        path = next((p for p in paths if p.is_file()), None)
        if path is not None:
            files.append(ConfigFile.read(path, default.package or ""))
    return files


def _partial(
    loader: ConfigLoader, config_name: str, parsed: ParsedOverrides
) -> tuple[dict[str, Any], Locator]:
    """The root's own values with overrides of them, where task and groups cannot be composed."""
    values = [o for o in parsed.values if o.key_or_group.split(".")[0] != "task"]
    locator = Locator(list, values)
    try:
        config = loader.load_configuration(config_name, ["~task"], RunMode.RUN)
    except COMPOSING:
        return {}, locator
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    apply_values(config, values)
    return _plain(config, locator)[0], locator


def _algorithm(
    config: DictConfig, values: Sequence[Override], options: Sequence[str]
) -> str | None:
    """The option of `algo` that a null choice means: named by a key, suggested, else ppo.

    A name that is no option is left for the check of types to report where it stands.
    """
    if config.hydra.runtime.choices.get("algo", "") is not None:
        return None
    named = [o.value() for o in values if o.key_or_group == "algo.name"]
    suggested = OmegaConf.select(config, "task.suggested.train.algo.name")
    written = OmegaConf.select(config, "algo.name")
    return next((n for n in (*named, written, suggested) if n in options), DEFAULT_ALGORITHM)


def _follows(error: Exception, parsed: ParsedOverrides) -> bool:
    """Whether an error only says that a group has no option, after its wrong one was left out."""
    return any(f"You must specify '{group}'" in str(error) for group in parsed.broken)


_INSTANTIATE = ("_target_", "_recursive_", "_convert_", "_partial_", "_args_")


def _plain(config: DictConfig, locator: Locator) -> tuple[dict[str, Any], list[LocatedProblem]]:
    """Resolve interpolations everywhere.

    Args:
        config: The composed config.
        locator: Finds the source of what fails.

    Returns:
        The plain tree without the keys that failed, and one problem for each of these.
    """
    walk = _Walk(locator)
    return walk.mapping(config, ""), walk.problems


class _Walk:
    def __init__(self, locator: Locator) -> None:
        self.problems: list[LocatedProblem] = []
        self._locator = locator

    def mapping(self, config: DictConfig, path: str) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key in config:
            where = f"{path}.{key!s}" if path else str(key)
            if key in _INSTANTIATE:
                self._report(where, f"{key} is not used here: name a function with func: NAME")
            elif self._readable(config, key, where):
                result[str(key)] = self._value(config[key], where)
        return result

    def _value(self, value: Any, path: str) -> Any:
        if isinstance(value, DictConfig):
            return self.mapping(value, path)
        if isinstance(value, ListConfig):
            indices = [i for i in range(len(value)) if self._readable(value, i, f"{path}.{i}")]
            return [self._value(value[i], f"{path}.{i}") for i in indices]
        return value

    def _readable(self, node: DictConfig | ListConfig, key: Any, path: str) -> bool:
        """Whether a value is there and resolves; reports it otherwise."""
        if OmegaConf.is_missing(node, key):
            self._report(path, "missing value (???): it must be set")
            return False
        try:
            node[key]
        except OmegaConfBaseException as error:
            reason = str(error).splitlines()[0]
            self._report(path, f"cannot resolve {_raw(node, key)!r}: {reason}")
            return False
        return True

    def _report(self, path: str, message: str) -> None:
        self.problems.append(LocatedProblem(path, message, source=self._locator.source(path)))


def _raw(node: DictConfig | ListConfig, key: Any) -> Any:
    child = node._get_node(key)  # the interpolation as written; OmegaConf has no public name for it
    return child._value() if child is not None and not isinstance(child, list) else None
