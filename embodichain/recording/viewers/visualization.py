"""EmbodiChain's `embodichain.lab.visualization`; `web.WebView` replaces its Viser page.

`SimulationManagerCfg.visualization` takes the config, and the environment calls `attach`.
`embodichain run viewer=web` serves the same page without a script.
"""

from __future__ import annotations

import argparse
import logging
import sys
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from embodichain.utils.configclass import configclass

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = [
    "ViserServerCfg",
    "VisualizationCfg",
    "add_viser_args_to_parser",
    "visualization_cfg_from_args",
]

_log = logging.getLogger(__name__)


@configclass
class ViserServerCfg:
    """Where the page is served; `verbose` has no effect."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 8080
    label: str = "EmbodiChain"
    """The page's title."""
    verbose: bool = False


@configclass
class VisualizationCfg:
    """Whether an environment is shown in a browser.

    The page shows one environment at a time, as fast as the browser draws: `scene_fps`,
    `max_visible_envs`, `point_cloud_max_points`, `sensor_image_fps` and `soft_body_fps` have no
    effect.
    """

    backend: Literal["none", "viser"] = "none"
    """``viser`` serves MuJoCo Studio's page; Viser is not needed."""
    scene_fps: float = 15.0
    env_ids: list[int] | None = [0]
    """The first one is shown first; the page can show the others."""
    max_visible_envs: int | None = None
    point_cloud_max_points: int = 100_000
    sensor_image_fps: float | None = 2.0
    soft_body_fps: float = 5.0
    allow_commands: bool = False
    """Whether the page may end episodes."""
    viser_server: ViserServerCfg = ViserServerCfg()

    def attach(self, env: BaseEnv) -> None:
        """Serve the page of an environment, which closes it; do nothing if `backend` is ``none``.

        Raises:
            ConfigError: If the address cannot be listened on.
            ValueError: If the backend is unknown.
        """
        if self.backend not in ("none", "viser"):
            raise ValueError(f"unknown backend {self.backend!r}; one of: none, viser")
        if self.backend == "none":
            return
        from embodichain.recording.viewers.web import PageOptions, WebView

        options = PageOptions(
            host=self.viser_server.host,
            port=self.viser_server.port,
            env_id=self.env_ids[0] if self.env_ids else 0,
            realtime=False,
            resets=self.allow_commands,
            title=self.viser_server.label,
        )
        view = WebView(env, options)
        env.add_observer(view)
        _log.warning("viewer: %s", view.address)
        if view.url != view.address:
            sys.stderr.write(f"viewer: {view.url}\n")  # logs have no token


def add_viser_args_to_parser(parser: argparse.ArgumentParser) -> None:
    """Add ``--viser`` and its options to a parser; the help notes options without an effect."""
    cfg = VisualizationCfg()
    add = parser.add_argument
    add("--viser", action="store_true", help="show an environment in a browser")
    add("--viser-host", default=cfg.viser_server.host, help="the address to listen on")
    add("--viser-port", type=int, default=cfg.viser_server.port, help="the port")
    add("--viser-env-ids", nargs="+", default=cfg.env_ids, help="which is shown first, or 'all'")
    without_effect = {
        "--viser-fps": cfg.scene_fps,
        "--viser-image-fps": cfg.sensor_image_fps,
        "--viser-soft-body-fps": cfg.soft_body_fps,
    }
    for flag, default in without_effect.items():
        add(flag, type=float, default=default, help="accepted for compatibility: no effect")


def visualization_cfg_from_args(args: argparse.Namespace) -> VisualizationCfg:
    """Return the config of the arguments of `add_viser_args_to_parser`, which may be absent.

    Raises:
        ValueError: If ``--viser-env-ids`` are not numbers.
    """
    cfg = VisualizationCfg()
    is_shown = bool(getattr(args, "viser", False))
    ids = getattr(args, "viser_env_ids", cfg.env_ids)
    env_ids = None
    if ids is not None and "all" not in ids:
        env_ids = [int(i) for i in ids]
    return VisualizationCfg(
        backend="viser" if is_shown else "none",
        env_ids=env_ids,
        allow_commands=is_shown,
        viser_server=ViserServerCfg(
            host=getattr(args, "viser_host", cfg.viser_server.host),
            port=getattr(args, "viser_port", cfg.viser_server.port),
        ),
    )
