"""MuJoCo Studio in the browser: look, pause, step, reset, rewards of each term."""

from __future__ import annotations

from embodichain.recording.viewers.showing import Audience, Shown, Viewing, viewer
from embodichain.recording.viewers.web import PageOptions, WebView

__all__ = ["show_page"]


@viewer("web", controls=True)
def show_page(viewing: Viewing) -> Shown:
    """Serve the page of an environment.

    Raises:
        ConfigError: If the address cannot be listened on, or the access does not fit it.
    """
    options = PageOptions(
        host=viewing.cfg.host,
        port=viewing.cfg.port,
        env_id=viewing.cfg.env,
        realtime=viewing.realtime,
        resets=viewing.resets,
        title=viewing.title,
        access=viewing.access,
    )
    view = WebView(viewing.env, options, stopped=viewing.stopped, teleop=viewing.teleop)
    viewing.env.add_observer(view)
    audience = Audience(
        is_watched=lambda: view.watched,
        what="the page",
        refresh=lambda: view.refresh(viewing.env),
        finish=view.finish,
    )
    return Shown(view.url, view.address, page=view, audience=audience)
