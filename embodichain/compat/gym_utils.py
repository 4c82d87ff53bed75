"""Launcher arguments of scripts, with EmbodiChain 0.2.1's names and defaults."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from embodichain.compat.gym_config.env_cfg import config_to_cfg
from embodichain.compat.gym_config.file import read_gym_config
from embodichain.utils.errors import ConfigError
from embodichain.utils.fields.defaults import DefaultFloat, DefaultInt, DefaultStr, is_given

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg

__all__ = [
    "DEFAULT_MANAGER_MODULES",
    "add_env_launcher_args_to_parser",
    "build_env_cfg_from_args",
    "config_to_cfg",
]

DEFAULT_MANAGER_MODULES = [
    f"embodichain.lab.gym.envs.managers.{name}"
    for name in ("actions", "randomization", "record", "events", "observations", "rewards")
]
"""Modules of EmbodiChain's functors; `config_to_cfg` finds their names without it."""
RENDERERS = ("hybrid", "fast-rt", "rt", "auto", "no-render")
_UNUSED = "accepted for compatibility: no effect"
_FLAGS: dict[str, tuple[Any, str]] = {
    "num_envs": (DefaultInt(1), "environments that run in parallel"),
    "device": (DefaultStr("cpu"), "where physics runs: cpu, cuda or cuda:N"),
    "headless": (False, "open no window"),
    "renderer": (
        DefaultStr("hybrid"),
        "accepted for compatibility: images are MuJoCo's in any case",
    ),
    "arena_space": (DefaultFloat(5.0), "metres between environments in viewers"),
    "gpu_id": (DefaultInt(0), "the card of --device cuda"),
}
"""Flags that are also keys of a gym config -> default and help."""


def add_env_launcher_args_to_parser(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of EmbodiChain's scripts.

    Args:
        parser: Gets ``--num_envs --device --headless --renderer --arena_space --gpu_id
            --gym_config --action_config --preview --filter_visual_rand
            --filter_dataset_saving``.
    """
    add = parser.add_argument
    for name, (default, text) in _FLAGS.items():
        if default is False:
            add(f"--{name}", action="store_true", help=text)
            continue
        choices = RENDERERS if name == "renderer" else None
        # Texts have no type: `str` would make a plain text of a default that is marked as one.
        value_type: Any = None
        if isinstance(default, int):
            value_type = int
        elif isinstance(default, float):
            value_type = float
        add(f"--{name}", type=value_type, default=default, choices=choices, help=text)
    add("--gym_config", type=str, default="", help="EmbodiChain's config of a task: YAML or JSON")
    add("--action_config", type=str, default=None, help="a YAML or JSON file for the script")
    add("--preview", action="store_true", help=_UNUSED)
    add("--filter_visual_rand", action="store_true", help="leave out visual randomization")
    add("--filter_dataset_saving", action="store_true", help="leave out dataset terms")


def build_env_cfg_from_args(
    args: argparse.Namespace,
    gym_config_modifier: Callable[[dict[str, Any]], dict[str, Any] | None] | None = None,
) -> tuple[EnvCfg, dict[str, Any], dict[str, Any]]:
    """Build an environment's config from the files and flags of a launcher.

    A flag that was typed overrides the file (in EmbodiChain defaults do too).

    Args:
        args: Arguments of `add_env_launcher_args_to_parser`; `gym_config` is EmbodiChain's config
            of the task, `action_config` any YAML or JSON.
        gym_config_modifier: Changes the content of the gym config before it is used.

    Returns:
        The config, the content of the gym config, and that of the action config (empty without).

    Raises:
        ConfigError: No gym config is named, a file cannot be read, or contains mistakes.
    """
    if not args.gym_config:
        raise ConfigError("no gym config is named: --gym_config FILE")
    config = read_gym_config(args.gym_config)
    if gym_config_modifier is not None:
        config = gym_config_modifier(config) or config
    values = {key: getattr(args, key, default) for key, (default, _) in _FLAGS.items()}
    flags = {key: value for key, value in values.items() if _was_typed(value)}
    if getattr(args, "filter_visual_rand", False):
        flags["env"] = {**(config.get("env") or {}), "filter_visual_rand": True}
    cfg = config_to_cfg({**config, **flags})
    action_config: dict[str, Any] = {}
    if args.action_config:
        action_config = read_gym_config(args.action_config)
    return cfg, config, action_config


def _was_typed(value: Any) -> bool:
    """Whether a flag was typed; a switch that is False was not."""
    return value is not False and is_given(value)
