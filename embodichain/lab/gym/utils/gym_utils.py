"""Launcher arguments of scripts, with EmbodiChain 0.2.1's names and defaults. No torch here.

The command `embodichain` has its own (`embodichain.cli`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, NoReturn

__all__ = ["add_env_launcher_args_to_parser", "build_env_cfg_from_args"]

RENDERERS = ("hybrid", "fast-rt", "rt", "auto", "no-render")


def add_env_launcher_args_to_parser(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that every script of EmbodiChain's understands.

    Args:
        parser: Gains ``--num_envs --device --headless --renderer --arena_space --gpu_id
            --gym_config --action_config --preview --filter_visual_rand
            --filter_dataset_saving``.
    """
    add = parser.add_argument
    add("--num_envs", type=int, default=1, help="environments that run in parallel")
    add("--device", type=str, default="cpu", help="where physics runs: cpu")
    add("--headless", action="store_true", help="open no window")
    add(
        "--renderer",
        choices=RENDERERS,
        default="hybrid",
        help="accepted for compatibility: pictures are MuJoCo's in any case",
    )
    add("--arena_space", type=float, default=5.0, help="metres between environments in viewers")
    add("--gpu_id", type=int, default=0, help="accepted for compatibility: no effect on the CPU")
    add("--gym_config", type=str, default="", help="EmbodiChain's config file (not read yet)")
    add("--action_config", type=str, default=None, help="EmbodiChain's action file (not read yet)")
    add("--preview", action="store_true", help="accepted for compatibility: no effect")
    add("--filter_visual_rand", action="store_true", help="leave out visual randomization")
    add("--filter_dataset_saving", action="store_true", help="leave out dataset terms")


def build_env_cfg_from_args(
    args: argparse.Namespace,
    gym_config_modifier: Callable[[dict[str, Any]], dict[str, Any]] | None = None,
) -> NoReturn:
    """Not available: EmbodiChain's own config files are not read yet.

    Raises:
        NotImplementedError: Always; says what to use instead.
    """
    raise NotImplementedError(
        "build_env_cfg_from_args is not available: EmbodiChain's gym config files are not read "
        "yet; declare the task in YAML and use embodichain.make(...)"
    )
