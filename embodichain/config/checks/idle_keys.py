"""Typed keys of something that is off: the port of a viewer where none is chosen.

A file may set them for when it is on. Who types one expects that it has an effect.
"""

from __future__ import annotations

from collections.abc import Iterable

from hydra.core.override_parser.types import Override

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.config.keys.schema import JobVerb, RootCfg
from embodichain.config.keys.viewers import NO_VIEWER
from embodichain.utils.errors import Problem

__all__ = ["idle_keys"]

_WINDOW = "native"
_READ_BY_WINDOWS = ("name", "env")
_READ_BY_VIEWERS = ("view_envs", "images")
"""Keys of the log that viewers read too."""


def idle_keys(root: RootCfg, overrides: Iterable[Override], verb: JobVerb) -> list[Problem]:
    """Return a note for each typed key that changes nothing, because what it is about is off.

    Args:
        root: The config.
        overrides: Values that were typed.
        verb: The verb of the job.
    """
    notes: list[Problem] = []
    for override in overrides:
        if override.is_delete():
            continue
        key = override.key_or_group
        section, _, name = key.partition(".")
        reason = _why_idle(root, section, name.partition(".")[0])
        if not reason and key == "viewer.wait_s" and verb in ("train", "collect"):
            reason = f"`{verb}` does not wait for those who look"
        if not reason and verb == "train":
            reason = _why_idle_in_training(root, section, name)
        if reason:
            notes.append(Problem(key, f"changes nothing: {reason}", source=COMMAND_LINE))
    return notes


def _why_idle(root: RootCfg, section: str, name: str) -> str:
    """Why a key has no effect; empty if it has one."""
    if section == "viewer":
        return _why_idle_viewer(root.viewer.name, name)
    if section == "record":
        return _why_idle_log(root, name)
    if section == "video" and name and not root.video:
        return "no film is made: video=true"
    if section == "wandb" and name != "mode" and root.wandb.mode == "disabled":
        return "wandb.mode is disabled"
    return ""


def _why_idle_viewer(viewer: str, name: str) -> str:
    if viewer == NO_VIEWER and name not in ("", "name"):
        return "no viewer is chosen: viewer=web"
    if viewer == _WINDOW and name and name not in _READ_BY_WINDOWS:
        return "viewer=native opens a window, and serves nothing"
    return ""


def _why_idle_log(root: RootCfg, name: str) -> str:
    if root.record.format == "none":
        is_read_by_viewer = name in _READ_BY_VIEWERS and root.viewer.name != NO_VIEWER
        if name in ("", "format") or is_read_by_viewer:
            return ""
        return "no log is written: record=mcap"
    if name == "keyframe_every" and root.record.state != "keyframes":
        return "it is for record.state=keyframes"
    return ""


def _why_idle_in_training(root: RootCfg, section: str, name: str) -> str:
    """A training has a log and a film of the evaluation at its end."""
    is_about_log = section == "record" and name not in ("", "format")
    is_about_film = section == "video" and bool(root.video)
    if root.eval.episodes == 0 and (is_about_log or is_about_film):
        return "it is for the evaluation at the end, and eval.episodes is 0"
    return ""
