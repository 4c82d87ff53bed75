"""`load_configured`: a model from the config of its run, and the weights of its checkpoint.

That is how a training resumes: spaces are the task's, arguments the config's, and nothing of the
checkpoint but weights is read.
"""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from gymnasium import Env
from pydantic import TypeAdapter, ValidationError
from stable_baselines3.common.base_class import BaseAlgorithm

from embodichain.config.keys.algorithms import AlgoCfg, AnyAlgoCfg
from embodichain.config.run_folder import CONFIG
from embodichain.learning.sb3.algorithms import Algorithm
from embodichain.learning.sb3.training_state import load_parameters
from embodichain.learning.sb3.vec_env import SB3VecEnv

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["load_configured", "run_config"]

_log = logging.getLogger(__name__)


def run_config(file: Path) -> Any:
    """Return the config of the run that a checkpoint belongs to; None if it cannot be read."""
    path = file.resolve().parent.parent / CONFIG
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError):
        return None


def load_configured(file: Path, algo: str, group: str, env: BaseEnv) -> BaseAlgorithm | None:
    """Load a model that can act; None if the checkpoint is in no run's folder.

    Args:
        file: The checkpoint.
        algo: The name of its algorithm.
        group: The observation group that it reads.
        env: An environment of its task, which is not stepped.

    Raises:
        ConfigError: If the task or the config do not fit the checkpoint, or it is damaged.
    """
    cfg = _read_algo(file)
    if cfg is None or cfg.name != algo:
        return None
    algorithm = Algorithm.of(cfg)
    arguments = dict(algorithm.arguments)
    arguments.pop("optimize_memory_usage", None)
    if algorithm.has_replay_buffer:  # acting needs none
        arguments["buffer_size"] = 1
        arguments["learning_starts"] = 0
    algorithm = dataclasses.replace(algorithm, arguments=arguments)
    vec_env = _Spaces(env, group, flatten=algorithm.flat, critic_groups=algorithm.critic_groups)
    model = algorithm.build(vec_env, None)
    load_parameters(model, file, "policy")
    model.env = None
    _log.warning("%s: only weights were read; the rest comes from its run's %s", file, CONFIG)
    return model


class _Spaces(SB3VecEnv):
    """The spaces of an environment that is not stepped, however it resets."""

    def _require(self, env: Env[Any, Any]) -> None:
        """Take any environment."""


def _read_algo(file: Path) -> AlgoCfg | None:
    """Return the algorithm in the config of a checkpoint's run; None without one of SB3."""
    tree = run_config(file)
    if not isinstance(tree, dict):
        return None
    try:
        cfg: Any = TypeAdapter(AnyAlgoCfg).validate_python(tree.get("algo"))
    except ValidationError:  # there is no algorithm, or one of another version
        return None
    return cfg if isinstance(cfg, AlgoCfg) else None
