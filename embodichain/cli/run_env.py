"""`embodichain run-env`: EmbodiChain's command, as `embodichain run --gym-config` with its flags.

Flags without an effect are accepted, with a note; everything else is `run`'s.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import click

from embodichain.cli.app import common, overrides, typed, verb
from embodichain.cli.launch import start
from embodichain.cli.run import run_job
from embodichain.compat.gym_utils import RENDERERS
from embodichain.utils.errors import ConfigError

__all__ = ["command"]

_KEYS = {
    "num_envs": "num_envs",
    "max_episodes": "episodes",
    "device": "device",
    "seed": "seed",
    "viser_host": "viewer.host",
    "viser_port": "viewer.port",
}
"""Flag -> key of the config of a run."""
_NO_EFFECT = {
    "renderer": "pictures are MuJoCo's",
    "arena_space": "every environment is its own world",
    "gpu_id": "physics runs on the CPU",
    "action_config": "not read: expert demonstrations are not generated here; policy=NAME acts",
    "preview": "viewer=web shows the run in a browser, viewer=native in a window",
    "filter_dataset_saving": "a run writes a log; `embodichain export` makes a data set of it",
    "viser_env_ids": "people choose the environment on the page",
    "viser_fps": "the page draws as fast as the browser asks",
    "viser_image_fps": "there are no camera images on the page",
    "viser_soft_body_fps": "there are no soft bodies",
}
_FLAGS: tuple[tuple[str, Any, str], ...] = (
    ("gym_config", str, "EmbodiChain's config of a task: YAML or JSON."),
    ("num_envs", int, "Environments that run in parallel."),
    ("max_episodes", int, "Episodes of each environment."),
    ("seed", int, "Seed of every random stream."),
    ("device", str, "Where physics runs: cpu."),
    ("headless", bool, "Open no window."),
    ("renderer", click.Choice(RENDERERS), "No effect."),
    ("arena_space", float, "No effect."),
    ("gpu_id", int, "No effect."),
    ("action_config", str, "No effect."),
    ("preview", bool, "No effect."),
    ("filter_visual_rand", bool, "Leave out visual randomization."),
    ("filter_dataset_saving", bool, "No effect."),
    ("viser", bool, "Show an environment in a browser."),
    ("viser_host", str, "The address to listen on."),
    ("viser_port", int, "The port."),
    ("viser_env_ids", str, "No effect."),
    ("viser_fps", float, "No effect."),
    ("viser_image_fps", float, "No effect."),
    ("viser_soft_body_fps", float, "No effect."),
)


def _flags(function: Any) -> Any:
    """Add EmbodiChain's flags in both spellings, all unset: only what was typed counts."""
    for name, kind, text in reversed(_FLAGS):
        spellings = {f"--{name}", f"--{name.replace('_', '-')}"}
        how: dict[str, Any] = {"is_flag": True} if kind is bool else {"type": kind}
        function = click.option(*sorted(spellings), name, help=text, **how)(function)
    return function


@verb(
    "run-env",
    ("run-env --gym_config gym_config.json --num_envs 4 --headless", "four environments"),
    ("run-env --gym_config gym_config.json record=none max_steps=100", "with keys of `run`"),
)
@overrides()
@_flags
@common(quiet=True)
def command(**options: Any) -> None:
    """Translate the flags, then run.

    Raises:
        ConfigError: No gym config is named, a flag is unknown, or what `run` finds wrong.
    """
    flags = SimpleNamespace(**options)
    if not flags.gym_config:
        raise ConfigError("no gym config is named: embodichain run-env --gym_config FILE")
    for flag, why in _NO_EFFECT.items():
        if options[flag] is not None and options[flag] is not False:  # 0 is a value that was typed
            sys.stderr.write(f"note: --{flag} has no effect: {why}\n")
    flags.words = tuple(_overrides(flags))
    flags.cfg = flags.info = flags.config_dir = None
    flags.multirun = False
    start("run", run_job, flags, typed())


def _overrides(flags: Any) -> Iterator[str]:
    for flag, key in _KEYS.items():
        value = getattr(flags, flag)
        if value is not None:
            yield f"{key}={value}"
    if flags.viser:
        yield "viewer=web"
    if flags.filter_visual_rand:
        yield from (f"~task.events.{name}" for name in _visual_events(flags.gym_config))
    several = flags.viser_env_ids is not None  # --viser-env-ids 0 1 2
    yield from (word for word in flags.words if not (several and (word.isdigit() or word == "all")))


def _visual_events(path: str) -> list[str]:
    """The events of a gym config that only change how things look."""
    from embodichain.compat.gym_config.conversion import convert
    from embodichain.compat.gym_config.file import read_gym_config
    from embodichain.compat.gym_config.functors import VISUAL

    events = convert(read_gym_config(path)).task.get("events", {})
    return [name for name, event in events.items() if event["func"] in VISUAL]
