"""`embodichain play`: a trained policy in a window. It is `run` with the viewer, and no log."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import click

from embodichain.cli.app import common, job_options, overrides, typed, verb
from embodichain.cli.jobs import FRESH, execute
from embodichain.cli.run import run_job
from embodichain.cli.trained import one_target, take
from embodichain.utils.errors import ConfigError

__all__ = ["command"]

_EPISODES = 5


@verb(
    "play",
    ("play last", "the newest training, five episodes"),
    ("play last --episodes 20 seed=3", "more of them"),
    ("play policy.onnx task=reach", "a file, in a task"),
    ("play last viewer=none record=mcap", "without a window, into a log"),
    keys=True,
)
@overrides("RUN|last|PATH [KEY=VALUE]...", "last")
@click.option("--episodes", type=int, metavar="N", help=f"How many; else {_EPISODES}.")
@common(config_dir=True, quiet=True)
def command(**kwargs: Any) -> None:
    """Show episodes of one policy."""
    from embodichain.config.hydra_loader import user_configs

    options = SimpleNamespace(**kwargs)
    with user_configs(options.config_dir):
        target, lines = one_target("play", options.words)
        episodes = options.episodes or take(lines, "episodes") or _EPISODES
        lines = [*_defaults(lines), f"episodes={episodes}", *job_options(options)]
        _need_display(target.policy, lines)
        execute(target.resolve(lines, FRESH), run_job, typed())


def _defaults(overrides: list[str]) -> list[str]:
    """Overrides with what `play` means beside them: one environment, a window, no log."""
    keys = {line.partition("=")[0] for line in overrides}
    ours = {"num_envs": "1", "viewer": "native", "record": "none"}
    return [*overrides, *(f"{key}={value}" for key, value in ours.items() if key not in keys)]


def _need_display(name: str, lines: list[str]) -> None:
    """Say before anything is built what can be done without a display."""
    from embodichain.lab.sim.viewer import has_display

    if "viewer=native" in lines and not has_display():
        raise ConfigError(
            "there is no display to open a window on (DISPLAY is not set). Without one: "
            f"`embodichain play {name} viewer=web` shows it in a browser; `embodichain eval {name} "
            "episodes=5` writes rollout.mcap, which Foxglove and Lichtblick show; viewer=none "
            "plays without a window"
        )
