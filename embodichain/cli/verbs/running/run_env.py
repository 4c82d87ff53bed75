"""`embodichain run-env`: EmbodiChain's command; `embodichain run --gym-config` with its flags.

Flags without an effect are accepted, with a note; everything else is as in `run`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import click

from embodichain.cli.jobs.job import start
from embodichain.cli.jobs.work.run_job import run_job
from embodichain.cli.verb import JobOptions, OverrideOptions, overrides, verb
from embodichain.compat.gym_utils import RENDERERS
from embodichain.utils.errors import ConfigError

__all__ = ["command"]

_KEYS = {
    "num_envs": (int, "num_envs", "Environments that run in parallel."),
    "max_episodes": (int, "episodes", "Episodes of each environment."),
    "seed": (int, "seed", "Seed of every random stream."),
    "device": (str, "device", "Where physics runs: cpu, cuda or cuda:N."),
    "viser_host": (str, "viewer.host", "The address to listen on."),
    "viser_port": (int, "viewer.port", "The port."),
}
"""Flag -> type, key of the config of a run, help."""
_SWITCHES = {
    "headless": "Open no window.",
    "viser": "Show an environment in a browser.",
    "filter_visual_rand": "Leave out visual randomization.",
}
_NO_EFFECT: dict[str, tuple[Any, str]] = {
    "renderer": (click.Choice(RENDERERS), "cameras and viewers draw with rasterizers"),
    "arena_space": (float, "every environment is its own world"),
    "action_config": (
        str,
        "declare `expert:` in the task: `embodichain collect` plays it",
    ),
    "gpu_id": (int, "it numbers the card of --device cuda"),
    "preview": (bool, "viewer=web shows the run in a browser, viewer=native in a window"),
    "filter_dataset_saving": (
        bool,
        "a run writes a log; `embodichain export` makes a data set of it",
    ),
    "viser_env_ids": (str, "the environment is chosen on the page"),
    "viser_fps": (float, "the page draws as fast as the browser requests"),
    "viser_image_fps": (float, "there are no camera images on the page"),
    "viser_soft_body_fps": (float, "there are no soft bodies"),
}
"""Flag -> type, and why it has no effect."""


def _flags(function: Any) -> Any:
    """Add EmbodiChain's flags in both spellings, without defaults."""
    file = "EmbodiChain's config of a task: YAML or JSON."
    flags: list[tuple[str, Any, str]] = [("gym_config", str, file)]
    flags += [(name, kind, text) for name, (kind, _, text) in _KEYS.items()]
    flags += [(name, bool, text) for name, text in _SWITCHES.items()]
    flags += [(name, kind, "No effect.") for name, (kind, _) in _NO_EFFECT.items()]
    for name, kind, text in reversed(flags):
        spellings = {f"--{name}", f"--{name.replace('_', '-')}"}
        how: dict[str, Any] = {"is_flag": True} if kind is bool else {"type": kind}
        function = click.option(*sorted(spellings), name, help=text, **how)(function)
    return function


@dataclass(frozen=True, kw_only=True)
class RunEnvOptions(OverrideOptions):
    """What was typed after `run-env`: EmbodiChain's flags under their own names.

    Attributes:
        gym_config: Path of EmbodiChain's config of a task.
        num_envs: Environments that run in parallel.
        max_episodes: Episodes of each environment.
        seed: Seed of every random stream.
        device: Where physics runs.
        viser_host: Address of the viewer's page.
        viser_port: Port of the page.
        headless: Open no window.
        viser: Show an environment in a browser.
        filter_visual_rand: Leave out visual randomization.
        renderer: No effect, as all that follow; see `_NO_EFFECT`.
        arena_space: No effect.
        action_config: No effect.
        gpu_id: The card of ``device=cuda``; else no effect.
        preview: No effect.
        filter_dataset_saving: No effect.
        viser_env_ids: No effect.
        viser_fps: No effect.
        viser_image_fps: No effect.
        viser_soft_body_fps: No effect.
    """

    gym_config: str | None
    num_envs: int | None
    max_episodes: int | None
    seed: int | None
    device: str | None
    viser_host: str | None
    viser_port: int | None
    headless: bool
    viser: bool
    filter_visual_rand: bool
    renderer: str | None
    arena_space: float | None
    action_config: str | None
    gpu_id: int | None
    preview: bool
    filter_dataset_saving: bool
    viser_env_ids: str | None
    viser_fps: float | None
    viser_image_fps: float | None
    viser_soft_body_fps: float | None


@verb(
    "run-env",
    ("run-env --gym_config gym_config.json --num_envs 4 --headless", "four environments"),
    ("run-env --gym_config gym_config.json record=none max_steps=100", "with keys of `run`"),
    options=RunEnvOptions,
    quiet=True,
)
@overrides()
@_flags
def command(options: RunEnvOptions) -> None:
    """Translate the flags, then run.

    Raises:
        ConfigError: No gym config is named, a flag is unknown, or `run` finds a mistake.
    """
    gym_config = options.gym_config
    if not gym_config:
        raise ConfigError("no gym config is named: embodichain run-env --gym_config FILE")
    if options.device == "cuda" and options.gpu_id is not None:
        options = replace(options, device=f"cuda:{options.gpu_id}", gpu_id=None)
    for flag, (_, why) in _NO_EFFECT.items():
        value = getattr(options, flag)
        if value is not None and value is not False:  # 0 is a value that was typed
            sys.stderr.write(f"note: --{flag} has no effect: {why}\n")
    job = JobOptions(
        words=tuple(_overrides(options, gym_config)),
        gym_config=gym_config,
        quiet=options.quiet,
        json=options.json,
    )
    start("run", run_job, job)


def _overrides(options: RunEnvOptions, gym_config: str) -> Iterator[str]:
    """The overrides of `run` that the flags stand for, and those that were typed."""
    for flag, (_, key, _) in _KEYS.items():
        value = getattr(options, flag)
        if value is not None:
            yield f"{key}={value}"
    if options.viser:
        yield "viewer=web"
    if options.filter_visual_rand:
        yield from (f"~task.events.{name}" for name in _visual_events(gym_config))
    several_ids = options.viser_env_ids is not None  # --viser-env-ids 0 1 2
    for word in options.words:
        is_id = word.isdigit() or word == "all"
        if not (several_ids and is_id):
            yield word


def _visual_events(path: str) -> list[str]:
    """The events of a gym config that only change visuals."""
    from embodichain.compat.gym_config.conversion import convert
    from embodichain.compat.gym_config.file import read_gym_config
    from embodichain.compat.gym_config.functors import VISUAL

    events = convert(read_gym_config(path)).task.get("events", {})
    return [name for name, event in events.items() if event["func"] in VISUAL]
