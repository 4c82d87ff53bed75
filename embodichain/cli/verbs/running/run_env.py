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

__all__ = ["FLAGS", "Flag", "command"]


@dataclass(frozen=True)
class Flag:
    """A flag of EmbodiChain's command.

    Attributes:
        name: Its name, and the field of `RunEnvOptions`.
        value_type: Type of its value; a flag of type bool has none.
        help: What the help says of it.
        key: The key of a run's config that it sets; empty if it does something else.
        why_no_effect: Why it has no effect; empty if it has one.
    """

    name: str
    value_type: Any
    help: str = "No effect."
    key: str = ""
    why_no_effect: str = ""

    def option(self) -> Any:
        """The decorator that adds it to a verb, in both spellings and without a default."""
        spellings = sorted({f"--{self.name}", f"--{self.name.replace('_', '-')}"})
        if self.value_type is bool:
            return click.option(*spellings, self.name, help=self.help, is_flag=True)
        return click.option(*spellings, self.name, help=self.help, type=self.value_type)


FLAGS = (
    Flag("gym_config", str, "EmbodiChain's config of a task: YAML or JSON."),
    Flag("num_envs", int, "Environments that run in parallel.", key="num_envs"),
    Flag("max_episodes", int, "Episodes of each environment.", key="episodes"),
    Flag("seed", int, "Seed of every random stream.", key="seed"),
    Flag("device", str, "Where physics runs: cpu, cuda or cuda:N.", key="device"),
    Flag("viser_host", str, "The address to listen on.", key="viewer.host"),
    Flag("viser_port", int, "The port.", key="viewer.port"),
    Flag("headless", bool, "Open no window."),
    Flag("viser", bool, "Show an environment in a browser."),
    Flag("filter_visual_rand", bool, "Leave out visual randomization."),
    Flag(
        "renderer",
        click.Choice(RENDERERS),
        why_no_effect="cameras and viewers draw with rasterizers",
    ),
    Flag("arena_space", float, why_no_effect="every environment is its own world"),
    Flag(
        "action_config",
        str,
        why_no_effect="declare `expert:` in the task: `embodichain collect` plays it",
    ),
    Flag("gpu_id", int, why_no_effect="it numbers the card of --device cuda"),
    Flag(
        "preview",
        bool,
        why_no_effect="viewer=web shows the run in a browser, viewer=native in a window",
    ),
    Flag(
        "filter_dataset_saving",
        bool,
        why_no_effect="a run writes a log; `embodichain export` makes a data set of it",
    ),
    Flag("viser_env_ids", str, why_no_effect="the environment is chosen on the page"),
    Flag("viser_fps", float, why_no_effect="the page draws as fast as the browser requests"),
    Flag("viser_image_fps", float, why_no_effect="there are no camera images on the page"),
    Flag("viser_soft_body_fps", float, why_no_effect="there are no soft bodies"),
)
"""EmbodiChain's flags, in the order of the help."""


def _add_flags(command: Any) -> Any:
    """Add EmbodiChain's flags to a verb."""
    for flag in reversed(FLAGS):
        command = flag.option()(command)
    return command


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
        renderer: No effect, as all that follow; see `FLAGS`.
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
@_add_flags
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
    for flag in FLAGS:
        value = getattr(options, flag.name)
        was_typed = value is not None and value is not False  # 0 is a value that was typed
        if flag.why_no_effect and was_typed:
            sys.stderr.write(f"note: --{flag.name} has no effect: {flag.why_no_effect}\n")
    job = JobOptions(
        words=tuple(_overrides(options, gym_config)),
        gym_config=gym_config,
        quiet=options.quiet,
        json=options.json,
    )
    start("run", run_job, job)


def _overrides(options: RunEnvOptions, gym_config: str) -> Iterator[str]:
    """Yield the overrides of `run` that the flags mean, and those that were typed."""
    for flag in FLAGS:
        value = getattr(options, flag.name)
        if flag.key and value is not None:
            yield f"{flag.key}={value}"
    if options.viser:
        yield "viewer=web"
    if options.filter_visual_rand:
        for name in _visual_events(gym_config):
            yield f"~task.events.{name}"
    for word in options.words:
        # EmbodiChain's --viser-env-ids takes several values; click leaves all but the first.
        is_env_id = word.isdigit() or word == "all"
        if options.viser_env_ids is None or not is_env_id:
            yield word


def _visual_events(path: str) -> list[str]:
    """The events of a gym config that only change visuals."""
    from embodichain.compat.gym_config.conversion import convert
    from embodichain.compat.gym_config.file import read_gym_config
    from embodichain.compat.gym_config.functors import VISUAL

    events = convert(read_gym_config(path)).task.get("events", {})
    return [name for name, event in events.items() if event["func"] in VISUAL]
