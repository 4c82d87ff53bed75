"""A server for Foxglove and Lichtblick: scene, joints, rewards, pictures of cameras."""

from __future__ import annotations

from dataclasses import replace

from embodichain.recording.viewers.foxglove import FoxgloveView
from embodichain.recording.viewers.showing import Audience, Shown, Viewing, viewer

__all__ = ["show_foxglove"]


@viewer("foxglove", pictures=True)
def show_foxglove(viewing: Viewing) -> Shown:
    """Serve the viewed environments, and the shown one, over Foxglove's WebSocket protocol.

    Raises:
        ConfigError: If the address cannot be listened on, or the access does not fit it.
    """
    first = viewing.cfg.env
    images = viewing.images
    if images is not None:
        images = replace(images, envs=sorted({first, *images.envs}))
    view = FoxgloveView(
        viewing.env,
        host=viewing.cfg.host,
        port=viewing.cfg.port,
        view_envs=sorted({first, *viewing.view_envs}),
        realtime=viewing.realtime,
        images=images,
        access=viewing.access,
        title=viewing.title,
    )
    viewing.env.add_observer(view)
    how = "Foxglove, Lichtblick: Open connection, Foxglove WebSocket"
    audience = Audience(
        is_watched=lambda: view.watched,
        what="the connection",
        refresh=lambda: view.refresh(viewing.env),
        finish=view.finish,
    )
    return Shown(view.server.url, view.server.address, how, audience=audience)
