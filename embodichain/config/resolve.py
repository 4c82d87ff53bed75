"""One call from overrides to a `Resolved` config: compose, validate, derive, freeze."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from embodichain.config.compose import Composed, compose
from embodichain.config.schema import RootCfg
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.utils.errors import ConfigError

__all__ = ["Resolved", "Verb", "resolve", "resolve_tree"]

Verb = Literal["run", "train"]


@dataclass(frozen=True)
class Resolved:
    """A config that was checked as a whole and can be built.

    Attributes:
        tree: Frozen plain mappings and tuples: what is written to files (`dump_yaml`).
        overrides: As typed.
        task_name: The option of the group `task`, or the task file's stem.
    """

    tree: Mapping[str, Any]
    overrides: tuple[str, ...]
    task_name: str

    @property
    def root(self) -> RootCfg:
        """A fresh `RootCfg`, everything filled in."""

    @property
    def env_cfg(self) -> EnvCfg:
        """A fresh `EnvCfg` for `BaseEnv`: physics, num_envs and seed filled in."""


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


def resolve_tree(tree: Mapping[str, Any], source: str, *, allow_import: bool = False) -> Resolved:
    """Rebuild a `Resolved` from a dumped config: a run folder's `config.yaml`, a log's attachment.

    Args:
        tree: The loaded YAML.
        source: What errors call it.
        allow_import: Whether its ``package.module:function`` may be imported.

    Raises:
        ConfigError: Holds every mistake.
    """
