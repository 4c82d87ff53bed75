"""Viewers of a run, attached to its environment by the names of the group `viewer`.

What they show and how is `embodichain.recording.viewers`' business. MuJoCo's own window is opened
by the environment itself: it has to stand before the first reset.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from embodichain.utils.addresses import is_loopback

if TYPE_CHECKING:
    from embodichain.cli.stopping import StopFlag
    from embodichain.config.schema import RootCfg
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["attach_viewer", "check_viewer", "warn_of_address"]


def attach_viewer(
    root: RootCfg,
    env: BaseEnv,
    stop: StopFlag,
    *,
    realtime: bool = True,
    resets: bool = True,
) -> None:
    """Attach the viewer that the config names; closing the environment closes it.

    Args:
        root: The config; a line about the viewer goes to stderr unless it is quiet.
        env: The environment, built.
        stop: Its flag ends a pause.
        realtime: Whether the run first keeps to the clock while somebody looks.
        resets: Whether people may end an episode.
    """
    viewer = root.viewer
    if viewer.name not in ("web", "foxglove"):
        return
    where = _serve(root, env, lambda: stop.stopped is not None, realtime, resets)
    logging.getLogger(__name__).info("viewer: %s", where)
    if not root.quiet and not root.json:
        sys.stderr.write(f"viewer: {where}\n")
    warn_of_address(viewer.host)


def warn_of_address(host: str) -> None:
    """Warn where a viewer with buttons can be reached from other machines."""
    if not is_loopback(host):
        sys.stderr.write(
            f"warning: the viewer listens on {host} and asks nobody who they are: everybody who "
            "reaches it can look and press its buttons\n"
        )


def check_viewer(root: RootCfg) -> None:
    """Refuse a viewer whose package is not installed.

    Raises:
        ConfigError: Names the extra.
    """
    if root.viewer.name == "foxglove":
        from embodichain.recording.viewers.foxglove_server import need_sdk

        need_sdk()


def _serve(
    root: RootCfg, env: BaseEnv, stopped: Callable[[], bool], realtime: bool, resets: bool
) -> str:
    """Start a server; returns where people find it."""
    viewer = root.viewer
    if viewer.name == "foxglove":
        from embodichain.recording.viewers.foxglove import FoxgloveView

        live = FoxgloveView(
            env,
            viewer.host,
            viewer.port,
            env_id=viewer.env,
            view_envs=root.record.view_envs,
            realtime=realtime,
        )
        env.add_observer(live)
        return f"{live.url} (Foxglove, Lichtblick: Open connection, Foxglove WebSocket)"
    from embodichain.recording.viewers.web import WebView

    view = WebView(
        env,
        viewer.host,
        viewer.port,
        env_id=viewer.env,
        realtime=realtime,
        resets=resets,
        stopped=stopped,
    )
    env.add_observer(view)
    return view.url
