"""Overrides that `embodichain.make` does not read: keys of the verbs of the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import fields

from embodichain.config.keys.schema import RootCfg
from embodichain.config.keys.viewers import NO_VIEWER
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["refuse_unread_overrides"]

_READ = ("task", "sim", "num_envs", "seed", "device", "gym_config")
"""Root keys that an environment is made from."""
_VIEWER = "viewer"
_WINDOW = "native"
_KEYS_OF_WINDOW = ("viewer.name", "viewer.env")
_INSTEAD = {
    "viewer": "viewer=native opens a window, and `embodichain run viewer=web` serves a page",
    "video": "render_mode='rgb_array' and env.render() make pictures",
    "scene_png": "render_mode='rgb_array' and env.render() make pictures",
    "record": "env.add_observer(McapRecorder(PATH, env)) of embodichain.recording writes a log",
    "policy": "embodichain.learning.load_policy(PATH, env) loads one",
    "episodes": "the loop that calls env.step() counts them",
    "max_steps": "the loop that calls env.step() counts them",
    "output_dir": "run_dir=FOLDER is the folder for the states of environments that diverge",
}
"""Root key -> what does in Python what the key does on the command line."""


def refuse_unread_overrides(lines: Sequence[str], viewer: str) -> None:
    """Refuse overrides of keys that have no effect on an environment.

    Args:
        lines: Overrides as typed.
        viewer: The name of the viewer that they choose: a window is opened by the simulation.

    Raises:
        ConfigError: Lists all such keys.
    """
    names = {field.name for field in fields(RootCfg)}
    problems: list[Problem] = []
    for line in lines:
        key = line.lstrip("+~").partition("=")[0]
        root_key = re.split(r"[./@]", key)[0]
        if root_key not in names or root_key in _READ:
            continue
        if root_key == _VIEWER and _is_of_window(key, viewer):
            continue
        message = "`embodichain.make` does not read it: it is a key of verbs such as `run`"
        instead = _INSTEAD.get(root_key)
        if instead is not None:
            message = f"{message}; {instead}"
        problems.append(Problem(key, message))
    if problems:
        raise ConfigError(problems)


def _is_of_window(key: str, viewer: str) -> bool:
    """Whether a key of the viewer says something about the window, or that there is no viewer."""
    if viewer == _WINDOW:
        return key == _VIEWER or key in _KEYS_OF_WINDOW
    return viewer == NO_VIEWER and key in (_VIEWER, "viewer.name")
