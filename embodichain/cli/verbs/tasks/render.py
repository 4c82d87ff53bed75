"""`embodichain render`: writes a picture of a task, of one environment or a grid of several."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.typing import NDArray

from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import overrides, verb
from embodichain.cli.words import pair, split_overrides
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["command"]

Picture = NDArray[np.uint8]
"""(height, width, 3) RGB."""

_SIZE_ALONE = "1280x960"
"""Pixels of one environment."""
_SIZE_IN_GRID = "480x360"
"""Pixels of one environment among several."""
_MOST_PIXELS = 2**28
"""Pixels of the whole picture."""
_LONGEST_SIDE = 8192
"""Pixels of a side of one environment; OpenGL libraries have limits from there on."""
_FORMATS = (".png", ".jpg", ".jpeg", ".webp")


@dataclass(frozen=True)
class RenderOptions:
    """What was typed after `render`.

    Attributes:
        words: Overrides, and the path of the picture.
        view: A view or camera of the scene.
        grid: Columns and rows of environments, ``4x3``.
        step: How many control steps to play first.
        size: Pixels of one environment, ``WIDTHxHEIGHT``.
        quiet: Print no progress and no report.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    view: str
    grid: str | None
    step: int
    size: str | None
    quiet: bool
    json: bool


@verb(
    "render",
    ("render task=reach reach.png", "the scene after a reset"),
    ("render task=reach later.png --step 50 seed=1", "after 50 control steps"),
    ("render task=reach zero.png --step 50 policy=zero", "with another policy"),
    ("render task=push_cube grid.png --grid 4x3", "twelve environments, four in a row"),
    options=RenderOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@overrides("task=NAME OUT [KEY=VALUE]...")
@click.option("--view", metavar="NAME", default="default", help="A view or camera of the scene.")
@click.option("--grid", metavar="CxR", help="C times R environments, from left to right.")
@click.option("--step", type=click.IntRange(min=0), default=0, help="After this many steps.")
@click.option("--size", metavar="WxH", help="Pixels of one environment.")
def command(options: RenderOptions) -> None:
    """Render environments of a task into a new picture (.png, .jpg, .webp).

    The policy is the one that `run` uses: the task's suggestion, or policy=NAME.

    Raises:
        ConfigError: The task has mistakes, there is no such view, or the file cannot be written.
    """
    out, lines = _split_words(options.words)
    columns = rows = 1
    size = options.size or _SIZE_ALONE
    if options.grid is not None:
        columns, rows = pair("--grid", options.grid, "COLUMNSxROWS, such as 4x3")
        size = options.size or _SIZE_IN_GRID
    width, height = pair("--size", size, "WIDTHxHEIGHT in pixels, such as 640x480")
    if max(width, height) > _LONGEST_SIDE:
        raise ConfigError(f"--size: a side has at most {_LONGEST_SIDE} pixels, got {size}")
    picture_width = columns * width
    picture_height = rows * height
    pixels = f"{picture_width}x{picture_height}"
    if picture_width * picture_height > _MOST_PIXELS:
        raise ConfigError(f"{pixels} pixels are too many: at most {_MOST_PIXELS:,}")
    refuse_unread("render", lines)
    env, facts = _simulate(lines, columns * rows, options.step)
    try:
        tiles = _draw(env, options.view, width, height)
    finally:
        env.close()
    grid = tiles.reshape(rows, columns, height, width, 3).swapaxes(1, 2)
    _save(grid.reshape(picture_height, picture_width, 3), out)
    if options.json:
        size_of_picture = [picture_width, picture_height]
        print_json({"file": str(out), "size": size_of_picture, "view": options.view, **facts})
    elif not options.quiet:
        sys.stdout.write(f"{out}: {pixels}, control step {options.step}, seed {facts['seed']}\n")


def _split_words(words: tuple[str, ...]) -> tuple[Path, list[str]]:
    """The picture to write, and the overrides."""
    files = [word for word in words if "=" not in word and Path(word).suffix.lower() in _FORMATS]
    if len(files) != 1:
        names = ", ".join(files) or "none"
        raise ConfigError(f"name one picture to write ({', '.join(_FORMATS)}), got: {names}")
    if os.path.lexists(files[0]):
        raise ConfigError(f"{files[0]} exists; it is never replaced")
    other_words = tuple(word for word in words if word not in files)
    return Path(files[0]), split_overrides(other_words)


def _simulate(lines: list[str], num_envs: int, steps: int) -> tuple[BaseEnv, dict[str, Any]]:
    """The environments after some control steps of the config's policy, and facts about them."""
    from embodichain.cli.jobs.job import policy_of
    from embodichain.config.environments.factory import make_env
    from embodichain.config.resolved import resolve
    from embodichain.learning.episode_statistics import EpisodeStatistics, play

    if any(line.partition("=")[0].lstrip("+~") == "num_envs" for line in lines):
        raise ConfigError("num_envs follows from --grid: leave it out")
    resolved = resolve([*lines, f"num_envs={num_envs}"], "run").pinned()
    env = make_env(resolved)
    try:
        with resolved.locating():
            policy = policy_of(resolved.root, env)
        obs, _ = env.reset()
        unlimited = EpisodeStatistics(num_envs, steps + 1)
        for _ in islice(play(env, policy, obs, unlimited), steps):
            pass
    except BaseException:
        env.close()
        raise
    facts = {
        "task": resolved.task_name,
        "num_envs": num_envs,
        "seed": resolved.root.seed,
        "control_step": steps,
    }
    return env, facts


def _draw(env: BaseEnv, view: str, width: int, height: int) -> Picture:
    """(N, height, width, 3) of all environments."""
    model = env.sim.scene.model
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if view not in cameras:
        message = f"--view {view}: there are {', '.join(cameras)}.{did_you_mean(view, cameras)}"
        raise ConfigError(message)
    return env.sim.render(None, view, width, height)


def _save(picture: Picture, out: Path) -> None:
    from PIL import Image

    from embodichain.utils.system.atomic import atomic_file

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(out, new=True) as temporary:
            Image.fromarray(picture).save(temporary)
    except OSError as error:
        raise ConfigError(f"cannot write {out}: {error}") from error
