"""EmbodiChain's `embodichain.lab.visualization`: its Viser page is our page in the browser.

`SimulationManagerCfg.visualization` takes the config, and the environment calls `attach`.
`embodichain run viewer=web` is the same page without a script.
"""

from __future__ import annotations

import argparse
import logging
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
    """Where the page is served."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 8080
    label: str = "EmbodiChain"
    """The page's title."""
    verbose: bool = False
    """No effect."""


@configclass
class VisualizationCfg:
    """Whether an environment is shown in a browser."""

    backend: Literal["none", "viser"] = "none"
    """``viser`` serves our own page; Viser is not needed."""
    scene_fps: float = 15.0
    """No effect: the page draws as fast as the browser asks."""
    env_ids: list[int] | None = [0]
    """The first one is shown first; people can choose another on the page."""
    max_visible_envs: int | None = None
    """No effect: one environment is shown at a time."""
    point_cloud_max_points: int = 100_000
    """No effect."""
    sensor_image_fps: float | None = 2.0
    """No effect."""
    soft_body_fps: float = 5.0
    """No effect."""
    allow_commands: bool = False
    """Whether people may end episodes on the page."""
    viser_server: ViserServerCfg = ViserServerCfg()

    def attach(self, env: BaseEnv) -> None:
        """Serve the page of an environment, which closes it; do nothing if `backend` is ``none``.

        Raises:
            ConfigError: The address cannot be listened on.
            ValueError: If the backend is unknown.
        """
        if self.backend not in ("none", "viser"):
            raise ValueError(f"unknown backend {self.backend!r}; one of: none, viser")
        if self.backend == "none":
            return
        from embodichain.recording.viewers.web import WebView

        server = self.viser_server
        view = WebView(
            env,
            server.host,
            server.port,
            env_id=self.env_ids[0] if self.env_ids else 0,
            realtime=False,
            resets=self.allow_commands,
            title=server.label,
        )
        env.add_observer(view)
        _log.warning("viewer: %s", view.url)


def add_viser_args_to_parser(parser: argparse.ArgumentParser) -> None:
    """Add ``--viser`` and the arguments that go with it.

    Args:
        parser: Gains them; those without an effect say so.
    """
    cfg, add = VisualizationCfg(), parser.add_argument
    add("--viser", action="store_true", help="show an environment in a browser")
    add("--viser-host", default=cfg.viser_server.host, help="the address to listen on")
    add("--viser-port", type=int, default=cfg.viser_server.port, help="the port")
    add("--viser-env-ids", nargs="+", default=cfg.env_ids, help="which is shown first, or 'all'")
    for flag, value in (
        ("--viser-fps", cfg.scene_fps),
        ("--viser-image-fps", cfg.sensor_image_fps),
        ("--viser-soft-body-fps", cfg.soft_body_fps),
    ):
        add(flag, type=float, default=value, help="accepted for compatibility: no effect")


def visualization_cfg_from_args(args: argparse.Namespace) -> VisualizationCfg:
    """Return what the arguments of `add_viser_args_to_parser` mean; missing ones are the defaults.

    Raises:
        ValueError: If ``--viser-env-ids`` are no numbers.
    """
    cfg = VisualizationCfg()
    shown = bool(getattr(args, "viser", False))
    ids = getattr(args, "viser_env_ids", cfg.env_ids)
    return VisualizationCfg(
        backend="viser" if shown else "none",
        env_ids=None if ids is None or "all" in ids else [int(i) for i in ids],
        allow_commands=shown,
        viser_server=ViserServerCfg(
            host=getattr(args, "viser_host", cfg.viser_server.host),
            port=getattr(args, "viser_port", cfg.viser_server.port),
        ),
    )
