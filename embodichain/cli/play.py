"""`embodichain play`: a trained policy in a window. It is `run` with the viewer, and no log."""

from __future__ import annotations

import os
import shlex
from typing import Any

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common
from embodichain.cli.jobs import COMMAND_VARIABLE, given
from embodichain.cli.trained import find_target, split_words, take
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

__all__ = ["main"]

_EPISODES = 5


def main(arguments: list[str]) -> int:
    """Show episodes of one policy."""
    parser = VerbParser(VERBS["play"])
    parser.add_argument("words", nargs="*", metavar="RUN|last|PATH|key=value", help="what to play")
    parser.add_argument("--episodes", type=int, metavar="N", help=f"how many; else {_EPISODES}")
    parser.add_argument("--quiet", "-q", action="store_true", help="no progress, no table")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    names, overrides = split_words(options.words)
    if len(names) != 1:
        raise ConfigError("play what? One of: RUN (a training's folder), last, PATH (a policy)")
    roots = [line.partition("=")[2] for line in overrides if line.startswith("output_dir=")]
    target = find_target(names[0], roots[-1] if roots else "outputs")
    given_episodes = options.episodes or take(overrides, "episodes") or _EPISODES
    flags = [f"{name}=true" for name in ("quiet", "json", "traceback") if getattr(options, name)]
    lines = [*_defaults(overrides), f"episodes={given_episodes}", *flags]
    _need_display(names[0], lines)
    os.environ[COMMAND_VARIABLE] = shlex.join(["embodichain", "play", *arguments])
    fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False, "resume": None}
    fresh |= {"max_steps": None, "video": None, "total_timesteps": None, "algo": None}
    fresh |= {"output_dir": "outputs", "allow_changed": False}
    from embodichain.cli.run import job
    from embodichain.config.search_path import user_configs

    with user_configs(options.config_dir), given(target.resolve(lines, fresh)):
        job({})
    return exits.OK


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
