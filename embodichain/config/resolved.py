"""One call from overrides to a `Resolved` config: compose, validate, derive, freeze."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from embodichain.config import derive
from embodichain.config.check_types import check_types
from embodichain.config.composed import Composed, compose
from embodichain.config.derive import Verb
from embodichain.config.frozen import freeze, thaw
from embodichain.config.locate import LocatedProblem
from embodichain.config.schema import RootCfg
from embodichain.config.validation import check, check_tree, source_of
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim.prepared_scene import PreparedScene
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Resolved", "Verb", "resolve", "resolve_tree"]


@dataclass(frozen=True)
class Resolved:
    """A config that was checked as a whole and can be built.

    Attributes:
        tree: Frozen plain mappings and tuples: what is written to files (`dump_yaml`).
        overrides: As typed.
        task_name: The option of the group `task`.
        notes: What of a gym config was left out or is read otherwise, and what was derived that
            changes the physics.
        source: From a key path to where the key was set, or empty text.
        prepared: The scene as the check has read and compiled it, for the first environment.
    """

    tree: Mapping[str, Any]
    overrides: tuple[str, ...]
    task_name: str
    notes: tuple[LocatedProblem, ...] = ()
    source: Callable[[str], str] = field(default=lambda path: "", repr=False, compare=False)
    prepared: PreparedScene = field(default_factory=PreparedScene, repr=False, compare=False)

    @cached_property
    def root(self) -> RootCfg:
        """The config as data classes, everything filled in; not to be changed, see `changed`."""
        checked = check_types(thaw(self.tree))
        if checked.root is None or checked.problems:
            raise ConfigError(checked.problems)
        return checked.root

    @property
    def env_cfg(self) -> EnvCfg:
        """A fresh `EnvCfg` for `BaseEnv`: `num_envs`, `seed` and `sim_cfg` filled in."""
        cfg = derive.env_cfg(self.root)
        cfg.sim_cfg.prepared_scene = self.prepared
        return cfg

    def changed(self, **values: Any) -> Resolved:
        """Return the config with other values of keys of the root."""
        return replace(self, tree=freeze({**self.tree, **values}))

    @contextmanager
    def locating(self, section: str = "") -> Iterator[None]:
        """Give the mistakes of a `ConfigError` raised inside the places where they were written.

        Args:
            section: What their key paths are relative to; empty is the root.
        """
        try:
            yield
        except ConfigError as error:
            raise type(error)([self._located(p, section) for p in error.problems]) from error

    def _located(self, problem: Problem, section: str) -> LocatedProblem:
        if isinstance(problem, LocatedProblem):
            return problem
        path = ".".join(part for part in (section, problem.path) if part)
        source = self.source(path) if path else ""
        return LocatedProblem.of(Problem(path, problem.message, problem.hint), source)


def resolve(
    config: Composed | Sequence[str],
    verb: Verb = "run",
    config_dir: str | Path | None = None,
) -> Resolved:
    """Check a config as a whole and fill in what follows.

    Args:
        config: What `compose` returned, or overrides.
        verb: Whose suggested values count.
        config_dir: With overrides: searched first.

    Raises:
        ConfigError: Holds every mistake as a `LocatedProblem`.
    """
    composed = config if isinstance(config, Composed) else compose(config, verb, config_dir)
    found = check(composed, verb)
    if found.problems:
        raise ConfigError(found.problems)
    tree, raised = derive.with_armature(derive.settle(found.types.tree, verb), found.scene)
    name = composed.choices.get("task") or "task"
    name = name.rpartition("/")[2]
    source = partial(source_of, composed=composed)
    notes = (*composed.notes, *raised)
    return Resolved(freeze(tree), composed.overrides, name, notes, source, found.scene)


def resolve_tree(
    tree: Mapping[str, Any],
    source: str | Callable[[str], str],
    verb: Verb = "run",
    *,
    task_name: str = "task",
    allow_import: bool = False,
) -> Resolved:
    """Check a config that was dumped: a run folder's `config.yaml`, a log's attachment.

    Args:
        tree: The loaded YAML.
        source: What messages call it, or from a key path to where the key was set.
        verb: Whose suggested values count, where keys are still null.
        task_name: What the task is called; the tree does not say.
        allow_import: Whether its ``package.module:function`` may be imported.

    Raises:
        ConfigError: Holds every mistake as a `LocatedProblem`.
    """
    found = check_tree(tree, verb, allow_import=allow_import)
    located = source if callable(source) else lambda path: source
    if found.problems:
        raise ConfigError([LocatedProblem.of(p, located(p.path)) for p in found.problems])
    settled, raised = derive.with_armature(derive.settle(found.types.tree, verb), found.scene)
    return Resolved(freeze(settled), (), task_name, raised, located, found.scene)
