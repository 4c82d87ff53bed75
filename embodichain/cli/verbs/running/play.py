"""`embodichain play`: shows a trained policy in a window; `run` with a viewer and without a log."""

from __future__ import annotations

from dataclasses import dataclass

import click

from embodichain.cli.jobs.job import FRESH, execute, output_overrides
from embodichain.cli.jobs.trained import parse_target, pop_override
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.jobs.work.run_job import run_job
from embodichain.cli.verb import OverrideOptions, command_line, overrides, verb
from embodichain.utils.errors import ConfigError

__all__ = ["command"]

_DEFAULTS = {"num_envs": "1", "viewer": "native", "record": "none"}
_EPISODES = "5"


@dataclass(frozen=True, kw_only=True)
class PlayOptions(OverrideOptions):
    """What was typed after `play`.

    Attributes:
        episodes: How many episodes; None reads the override.
    """

    episodes: int | None


@verb(
    "play",
    ("play last", "the newest training, five episodes"),
    ("play last --episodes 20 seed=3", "more of them"),
    ("play policy.onnx task=reach", "a file, in a task"),
    ("play last viewer=none record=mcap", "without a window, into a log"),
    options=PlayOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@overrides("RUN|last|PATH [KEY=VALUE]...", "last")
@click.option("--episodes", type=int, metavar="N", help=f"How many episodes. Default: {_EPISODES}.")
def command(options: PlayOptions) -> None:
    """Show episodes of one policy."""
    target, lines = parse_target("play", options.words)
    refuse_unread("play", lines)
    episodes = pop_override(lines, "episodes", _EPISODES)
    if options.episodes:
        episodes = str(options.episodes)
    typed_keys = {line.partition("=")[0] for line in lines}
    lines += [f"{key}={value}" for key, value in _DEFAULTS.items() if key not in typed_keys]
    lines.append(f"episodes={episodes}")
    lines += output_overrides(options)
    resolved = target.resolve(lines, FRESH)
    _check_display(target.policy, lines)
    execute(resolved, run_job, command_line())


def _check_display(name: str, lines: list[str]) -> None:
    """Check before building that a window can be opened, if one is asked for.

    Raises:
        ConfigError: There is no display; names what shows or plays the policy without one.
    """
    from embodichain.utils.system.display import has_display

    if "viewer=native" in lines and not has_display():
        raise ConfigError(
            "there is no display to open a window on (DISPLAY is not set). Without one: "
            f"`embodichain play {name} viewer=web` shows it in a browser; `embodichain eval {name} "
            "episodes=5` writes rollout.mcap, which Foxglove and Lichtblick show; viewer=none "
            "plays without a window"
        )
