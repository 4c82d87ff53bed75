"""`Resolved`: a composed, checked and frozen config with every value filled in."""

from __future__ import annotations

import copy
import json
import secrets
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import yaml

from embodichain.config.checks.check_result import Check
from embodichain.config.checks.compiled_scene import compile_declared
from embodichain.config.checks.validation import check_composed, check_tree, source_of_values
from embodichain.config.checks.viewer_access import access_of, take_token, without_token
from embodichain.config.composition.composed import Composed, compose
from embodichain.config.composition.environment import notes_of_today, taken_today
from embodichain.config.keys.check_types import check_types
from embodichain.config.keys.schema import JobVerb, RootCfg
from embodichain.config.learning_scale import doubtful_scale, scale_learning
from embodichain.config.run_folder import (
    CHECKPOINT,
    CONFIG,
    named_checkpoint,
    newest_run,
    versions,
)
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.terms.term_errors import KeySources
from embodichain.lab.gym.policies import PRETRAINED
from embodichain.lab.sim.cfg import SimulationManagerCfg, choose_engine
from embodichain.lab.sim.compiler.names import exact_pattern
from embodichain.utils.env_text import EnvText, env_texts, hidden
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.system.access import AUTO, Access
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.scene_setup.declared_scene import DeclaredScene
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene

__all__ = [
    "Checked",
    "Resolved",
    "build_env",
    "check_config",
    "compile_scene_of",
    "dump_yaml",
    "freeze",
    "resolve",
    "resolve_tree",
    "thaw",
    "write_record",
]

_DEFAULTS: dict[JobVerb, dict[str, Any]] = {
    "run": {"num_envs": 1, "device": "cpu", "episodes": 1, "policy": "random"},
    "train": {"num_envs": 1, "device": "cpu"},
    "collect": {"num_envs": 64, "device": "cpu", "episodes": 100, "policy": "expert"},
}
_SEED_BITS = 31
_KWARGS = ("autoreset_mode", "render_mode", "run_dir")
"""Arguments of `BaseEnv` besides its config."""
_PATHS = ("output_dir", "policy", "dataset", "resume")
"""Keys of the root whose texts are paths, which a summary names."""
_OF_ROOT = ("num_envs",)
"""Keys of the root that the simulation names, and nothing else has."""
_OF_ENV = ("sim", "task")
"""Sections of the root that an environment reads."""
_OF_MAKE = ("task", "num_envs", "overrides", "device", "seed", "config_dir")
"""Arguments of `embodichain.make`, for messages."""


@dataclass(frozen=True)
class Resolved:
    """A checked config that can be built.

    Attributes:
        tree: Frozen plain mappings and tuples, as written to files (`dump_yaml`).
        overrides: As typed, without the viewer's token.
        task_name: The option of the group `task`.
        notes: What was left out or changed in converting a gym config, given keys that change
            nothing, and derived values that change the physics.
        source: Function from a key path to where the key was set, or an empty string.
        declared: The scene of the task as the check has read it, for `compile_scene_of`; None:
            that reads the files again. It is not a part of the config.
        token: The viewer's, which `tree` does not have; ``auto`` and ``none`` as in the config.
        varied: Key paths that variations have set. It is not a part of the config.
    """

    tree: Mapping[str, Any]
    overrides: tuple[str, ...]
    task_name: str
    notes: tuple[Problem, ...] = ()
    source: Callable[[str], str] = field(default=lambda path: "", repr=False, compare=False)
    declared: DeclaredScene | None = field(default=None, repr=False, compare=False)
    token: str = field(default=AUTO, repr=False, compare=False)
    varied: frozenset[str] = field(default=frozenset(), repr=False, compare=False)

    def __post_init__(self) -> None:
        """Take the viewer's token out of the overrides, which are recorded."""
        object.__setattr__(self, "overrides", without_token(self.overrides))

    @property
    def access(self) -> Access:
        """Who may use the viewer."""
        return access_of(self.root.viewer, self.token)

    @cached_property
    def root(self) -> RootCfg:
        """The config as data classes with all values; do not modify it, use `changed`."""
        checked = check_types(thaw(self.tree))
        if checked.root is None or checked.problems:
            raise ConfigError(checked.problems)
        return checked.root

    @property
    def env_cfg(self) -> EnvCfg:
        """A fresh `EnvCfg` for `BaseEnv`: `num_envs`, `seed` and `sim_cfg` filled in."""
        root = self.root
        cfg = copy.deepcopy(root.task)
        cfg.num_envs = root.num_envs or 1
        cfg.seed = root.seed
        cfg.first_env = root.sim.first_env
        cfg.sim_cfg = SimulationManagerCfg(
            headless=root.viewer.name != "native",
            window_env=root.viewer.env,
            num_envs=cfg.num_envs,
            sim_device=root.device or "cpu",
            engine=root.sim.engine,
            warp=copy.deepcopy(root.sim.warp),
            num_threads=root.sim.num_threads,
            persistent=root.sim.persistent,
        )
        cfg.key_sources = KeySources(self.source, varied=self.varied)
        return cfg

    def changed(self, **values: Any) -> Resolved:
        """Return a copy with other values for keys of the root."""
        declared = None if "task" in values else self.declared
        return replace(self, tree=freeze({**self.tree, **values}), declared=declared)

    def pinned(self) -> Resolved:
        """Return a copy in which `last` and links are the folders that they refer to now.

        Later runs change them. A path that the environment gives stays as it is.

        Raises:
            ConfigError: The training that `last` refers to does not exist any more.
        """
        pinned = self
        dataset = self.tree.get("dataset")  # a run of an earlier version has none
        if dataset is not None:
            paths = [dataset] if isinstance(dataset, str) else dataset
            pinned = pinned.changed(dataset=[_absolute_path(path) for path in paths])
        policy = self.tree["policy"]
        if not isinstance(policy, str) or isinstance(policy, EnvText):
            return pinned
        if policy == "last":
            newest = newest_run(self.tree["output_dir"], CHECKPOINT)
            if newest is None:
                raise ConfigError("policy: there is no training for 'last' any more")
            return pinned.changed(policy=str(newest.resolve()))
        checkpoint = named_checkpoint(policy)
        if not checkpoint.exists():  # another kind of policy
            return pinned
        return pinned.changed(policy=str(checkpoint.resolve()))

    def record(self, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Return facts about the run for a file: paths from the environment are interpolations.

        Args:
            facts: Name -> value; a text may be a value of the root, or a path below it.
        """
        paths_from_env = [text for _, text in env_texts({k: self.tree.get(k) for k in _PATHS})]

        def recorded(value: Any) -> Any:
            if isinstance(value, str):
                for path in paths_from_env:
                    if value == path or value.startswith(f"{path}/"):
                        return f"{path.written}{value[len(path) :]}"
            if is_dataclass(value):
                return hidden(repr(value))
            return value

        record = {name: recorded(value) for name, value in facts.items()}
        if isinstance(record.get("error"), str):
            record["error"] = hidden(record["error"])
        return record

    def locating(self, section: str = "") -> AbstractContextManager[None]:
        """Add file and line to the mistakes of a `ConfigError` raised inside the context.

        Args:
            section: The key that their key paths are relative to; empty is the root.
        """
        return _locating(self.source, section)


def _absolute_path(path: str) -> str:
    """A path with links resolved; one that the environment gives stays as it is."""
    if isinstance(path, EnvText):
        return path
    return str(Path(path).resolve())


@contextmanager
def _locating(source: Callable[[str], str], section: str) -> Iterator[None]:
    """Add file and line to mistakes; see `Resolved.locating`."""
    try:
        yield
    except ConfigError as error:
        raise type(error)([_located(p, source, section) for p in error.problems]) from error


def _located(problem: Problem, source: Callable[[str], str], section: str) -> Problem:
    """A problem with its place, if it has none."""
    if problem.source:
        return problem
    path = ".".join(part for part in (section, problem.path) if part)
    key = path.rpartition(".")[2]
    if key in _OF_ROOT:
        path = key
    return problem.at(source(path) if path else "", path)


@dataclass(frozen=True)
class Checked:
    """A config that was checked, with its mistakes.

    Attributes:
        check: The mistakes, the config as data classes, and the declared scene.
        verb: The verb for which the task's suggestions are used.
        task_name: The option of the group `task`.
        source: Function from a key path to where the key was set, or an empty string.
        overrides: As typed.
        notes: What was left out or changed in converting a gym config.
        ships: Whether the policy that ships for the task may be chosen.
        varied: Key paths that variations have set.
    """

    check: Check
    verb: JobVerb
    task_name: str
    source: Callable[[str], str]
    overrides: tuple[str, ...] = ()
    notes: tuple[Problem, ...] = ()
    ships: bool = False
    varied: frozenset[str] = frozenset()

    def locating(self, section: str = "") -> AbstractContextManager[None]:
        """Add file and line to the mistakes raised inside the context; see `Resolved.locating`."""
        return _locating(self.source, section)

    def resolved(self) -> Resolved:
        """Return the config with defaults and derived values filled in.

        Raises:
            ConfigError: Lists every mistake with its place.
        """
        resolved = _fill_in(self.check, self.verb, self.task_name, self.source)
        if self.ships:
            resolved = _with_pretrained(resolved)
        notes = (*self.notes, *resolved.notes)
        return replace(resolved, overrides=self.overrides, notes=notes, varied=self.varied)


def resolve(
    config: Composed | Sequence[str],
    verb: JobVerb = "run",
    config_dir: str | Path | None = None,
) -> Resolved:
    """Check a whole config and fill in defaults and derived values.

    Args:
        config: The result of `compose`, or overrides.
        verb: The verb for which the task's suggestions are used.
        config_dir: With overrides: a folder searched first.

    Raises:
        ConfigError: Lists every mistake with its place.
    """
    composed = config if isinstance(config, Composed) else compose(config, verb, config_dir)
    return check_config(composed, verb).resolved()


def check_config(composed: Composed, verb: JobVerb) -> Checked:
    """Check a whole config.

    Args:
        composed: The result of `compose`.
        verb: The verb for which the task's suggestions are used.
    """
    name = (composed.choices.get("task") or "task").rpartition("/")[2]
    return Checked(
        check=check_composed(composed, verb),
        verb=verb,
        task_name=name,
        source=source_of_values(composed, verb),
        overrides=composed.overrides,
        notes=composed.notes,
        ships=True,
        varied=frozenset(composed.locator.origins),
    )


def resolve_tree(
    tree: Mapping[str, Any],
    source: str | Callable[[str], str],
    verb: JobVerb = "run",
    *,
    task_name: str = "task",
    allow_import: bool = False,
) -> Resolved:
    """Check a dumped config: a run folder's `config.yaml` or a log's attachment.

    Args:
        tree: The loaded YAML. Today's values of variables of the environment are taken for its
            interpolations, and a note says so.
        source: Its name in messages, or a function from a key path to where the key was set.
        verb: The verb for which the task's suggestions are used, for null keys.
        task_name: The task's name, which the tree does not contain.
        allow_import: Whether its ``package.module:function`` may be imported.

    Raises:
        ConfigError: Lists every mistake with its place.
    """
    located = source if callable(source) else lambda path: source
    tree = taken_today(tree, source if isinstance(source, str) else "")
    notes = notes_of_today(tree)
    check = check_tree(tree, located, verb, allow_import=allow_import)
    return Checked(check, verb, task_name, located, notes=notes).resolved()


def _fill_in(check: Check, verb: JobVerb, task_name: str, source: Callable[[str], str]) -> Resolved:
    """The checked config with defaults and derived values; raises if it has mistakes."""
    if check.problems:
        raise ConfigError(check.problems)
    tree = _with_defaults(check.types.tree, verb)
    declared = check.scene
    notes: tuple[Problem, ...] = ()
    if declared is not None:
        tree, notes = _with_armature(tree, declared.added_armature())
        declared = declared.with_given_armature()
    if verb == "train" and isinstance(tree["algo"], Mapping):
        tree, choices, doubts = _with_learning_scale(tree)
        notes = (*notes, *choices, *(problem.at(source(problem.path)) for problem in doubts))
    recorded, token = take_token(tree)
    return Resolved(
        tree=freeze(recorded),
        overrides=(),
        task_name=task_name,
        notes=(*check.notes, *notes),
        source=source,
        declared=declared,
        token=token,
    )


def _with_pretrained(resolved: Resolved) -> Resolved:
    """The config with the file of the policy that ships for its task, where that is chosen."""
    policy = resolved.tree["policy"]
    has_params = isinstance(policy, Mapping)
    name = policy["func"] if has_params else policy
    if name != PRETRAINED:
        return resolved
    from embodichain.data.pretrained import pretrained

    with resolved.locating():
        file = str(pretrained(resolved.task_name).file)
    return resolved.changed(policy={**policy, "func": file} if has_params else file)


def _with_defaults(tree: Mapping[str, Any], verb: JobVerb) -> dict[str, Any]:
    """A copy with defaults for null keys; a null seed is drawn, so that it can be recorded."""
    filled = copy.deepcopy(dict(tree))
    for key, default in _DEFAULTS[verb].items():
        if filled.get(key) is None:
            filled[key] = default
    if filled.get("seed") is None:
        filled["seed"] = secrets.randbits(_SEED_BITS)
    sim = filled["sim"]
    sim["engine"], _ = choose_engine(sim.get("engine"), filled["device"])
    return filled


def _with_learning_scale(
    tree: dict[str, Any],
) -> tuple[dict[str, Any], list[Problem], list[Problem]]:
    """The config of a training with the keys that say what an update learns from.

    A training that is resumed goes on as it began.

    Returns:
        The config; notes on chosen values; doubts about it.
    """
    num_envs = tree["num_envs"]
    total_timesteps = tree["total_timesteps"]
    scale = scale_learning(tree["algo"], num_envs, total_timesteps)
    chosen: dict[str, Any] = dict(scale.chosen)
    notes: list[Problem] = []
    if tree["resume"] is None:
        notes = scale.notes()
    else:
        earlier = _algo_of(Path(tree["resume"]))
        if earlier is not None:
            chosen = {key: earlier.get(key) for key in chosen}
    algo = {**tree["algo"], **chosen}
    return {**tree, "algo": algo}, notes, doubtful_scale(algo, num_envs, total_timesteps)


def _algo_of(folder: Path) -> Mapping[str, Any] | None:
    """The algorithm's config of an earlier training; None if its folder has no config.

    Raises:
        ConfigError: The config is not YAML.
    """
    path = folder / CONFIG
    if not path.is_file():
        # `train` in Python writes checkpoints and nothing else; `check_training` refuses a folder
        # that does not exist.
        return None if folder.is_dir() else {}
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError([Problem("resume", f"cannot read {path}: {error}")]) from error
    algo = tree.get("algo") if isinstance(tree, Mapping) else None
    if not isinstance(algo, Mapping):
        return {}
    return algo


def _with_armature(
    tree: Mapping[str, Any], added: Mapping[str, Mapping[str, float]]
) -> tuple[dict[str, Any], tuple[Problem, ...]]:
    """A copy with the armature of joints without one; a note for each changed articulation.

    Args:
        tree: The config.
        added: Key path of an articulation in the task -> joint -> armature; only joints for which
            the task gives none.
    """
    changed = copy.deepcopy(dict(tree))
    notes = []
    for path, armature in added.items():
        entity = changed["task"]
        for key in path.split("."):
            entity = entity[key]
        drives = dict(entity.get("drive_pros") or {})
        entity["drive_pros"] = drives
        by_pattern = {exact_pattern(joint): value for joint, value in armature.items()}
        drives["armature"] = {**(drives.get("armature") or {}), **by_pattern}
        listed = ", ".join(f"{joint}: {value:.4g}" for joint, value in armature.items())
        message = f"raised to {{{listed}}}, because limited drives would chatter at the time step"
        notes.append(Problem(f"task.{path}.drive_pros.armature", message))
    return changed, tuple(notes)


def write_record(folder: Path, resolved: Resolved, argv: Sequence[str] | None = None) -> None:
    """Write ``config.yaml``, ``overrides.yaml``, ``command.txt`` and ``versions.json``.

    Args:
        folder: A claimed folder.
        resolved: The config of the run.
        argv: The command line; None is that of this process.

    Raises:
        ConfigError: A file cannot be written (the disk is full); gives its name and the reason.
    """
    command = shlex.join(without_token(sys.argv if argv is None else argv))
    files = {
        CONFIG: dump_yaml(resolved.tree),
        "overrides.yaml": dump_yaml(list(resolved.overrides)),
        "command.txt": f"cd {shlex.quote(str(Path.cwd()))}\n{command}\n",
        "versions.json": json.dumps(versions(), indent=2) + "\n",
    }
    for name, text in files.items():
        try:
            write_text(folder / name, text)
        except OSError as error:
            raise ConfigError(f"cannot write {folder / name}: {error}") from error


def freeze(value: Any) -> Any:
    """Return an immutable deep copy: read-only mappings, and tuples for lists."""
    if isinstance(value, Mapping):
        return MappingProxyType({key: freeze(item) for key, item in value.items()})
    if isinstance(value, (list, tuple)):
        return tuple(freeze(item) for item in value)
    return value


def thaw(value: Any) -> Any:
    """Return a mutable deep copy of a result of `freeze`: dicts and lists."""
    if isinstance(value, Mapping):
        return {key: thaw(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [thaw(item) for item in value]
    return value


def dump_yaml(value: Any) -> str:
    """Return a tree as YAML, with keys in order, no aliases, and lists of scalars on one line.

    `EnvText` is written as its interpolation.
    """
    return yaml.dump(
        thaw(value),
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        width=100,
        default_flow_style=None,
    )


class _Dumper(yaml.SafeDumper):
    """Writes shared parts in full: anchors would depend on how the tree was built.

    Text of the environment is written as its interpolation.
    """

    def ignore_aliases(self, data: Any) -> bool:
        """Never write an alias."""
        return True

    def env_text(self, text: EnvText) -> yaml.ScalarNode:
        """Represent text of the environment."""
        return self.represent_str(text.written)


_Dumper.add_representer(EnvText, _Dumper.env_text)


def compile_scene_of(resolved: Resolved) -> CompiledScene | None:
    """Compile the scene of a config: the step between resolving it and building environments.

    Any number of environments may be built from the result (`build_env`), which none writes to. It
    is not pickled: a worker process compiles its own.

    Args:
        resolved: A checked config with every value filled in.

    Returns:
        The scene; None where the class that the config names may add entities to it, which is then
        compiled inside the build.

    Raises:
        ConfigError: Lists every mistake that only the compiled scene shows, with its place.
    """
    root = resolved.root
    if root.task.id is not None:
        from embodichain.lab.gym.utils.registration import config_declares_scene

        if not config_declares_scene(_registered_id(root.task)):
            return None
    declared = resolved.declared
    if declared is None:
        from embodichain.lab.gym.envs.scene_setup.declared_scene import describe  # imports MuJoCo

        declared = describe(root.task, root.num_envs)
    with resolved.locating():
        return compile_declared(root, declared)


def _registered_id(task: EnvCfg) -> str:
    """The id of the class that a task names, without its module."""
    return str(task.id).rpartition(":")[2]


def build_env(resolved: Resolved, compiled_scene: CompiledScene | None, **kwargs: Any) -> BaseEnv:
    """Build the environment of a config, as an instance of the class that the config names.

    Args:
        resolved: A checked config with every value filled in.
        compiled_scene: The result of `compile_scene_of`.
        **kwargs: For `BaseEnv`, or for the class.

    Raises:
        ConfigError: A mistake that is only found by building, with its place.
        TypeError: If an argument is unknown.
    """
    cfg = resolved.env_cfg
    if cfg.id is not None:
        from embodichain.lab.gym.envs.base_env import BaseEnv
        from embodichain.lab.gym.utils import registration

        if compiled_scene is not None:  # other classes need not know the argument
            kwargs["compiled_scene"] = compiled_scene
        with resolved.locating("task"):
            env_of_class = registration.make(_registered_id(cfg), cfg=cfg, **kwargs)
        if isinstance(env_of_class, BaseEnv):  # the class may be any callable
            env_of_class.task_name = resolved.task_name
        return env_of_class
    for key in kwargs:
        if key not in _KWARGS:
            known = [*_OF_MAKE, *_KWARGS]
            hint = did_you_mean(key, known)
            if key in resolved.tree:
                hint = f" {key} is a key of `embodichain run`; the environment does not read it."
                if key in _OF_ENV:
                    hint = f" The config's key is set by overrides=['{key}.NAME=VALUE']."
            raise TypeError(f"unknown argument {key!r}; there are: {', '.join(known)}.{hint}")
    from embodichain.lab.gym.envs.base_env import BaseEnv

    with resolved.locating("task"):
        env = BaseEnv(cfg, compiled_scene=compiled_scene, **kwargs)
        env.task_name = resolved.task_name
        if cfg.expert is not None:
            from embodichain.lab.gym.expert.fingers import check_fingers

            try:
                check_fingers(env)
            except ConfigError:
                env.close()
                raise
        return env
