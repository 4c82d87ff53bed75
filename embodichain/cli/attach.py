"""What a job attaches to its environment: log, viewer, policy, first picture, film."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from embodichain.lab.gym.policies import Policy, resolve_policy

if TYPE_CHECKING:
    import mujoco

    from embodichain.cli.jobs import Job
    from embodichain.cli.process import StopFlag
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.config.schema import RootCfg
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording import McapRecorder
    from embodichain.recording.film import Filmed

__all__ = [
    "VIDEO",
    "StartPicture",
    "attach_log",
    "attach_viewer",
    "check_attachments",
    "ended_early",
    "film_job",
    "policy_of",
    "show_pictures",
    "warn_if_public",
]

VIDEO = "rollout.mp4"
"""A run's film, in its folder."""
_SIZE = (1280, 960)
_log = logging.getLogger(__name__)


def check_attachments(root: RootCfg) -> None:
    """Refuse a film or a viewer whose package is not installed.

    Raises:
        ConfigError: Names the extra.
    """
    if root.video:
        from embodichain.utils.video import need_encoder

        need_encoder()
    if root.viewer.name == "foxglove":
        from embodichain.recording.viewers.foxglove import need_sdk

        need_sdk()


def policy_of(
    root: RootCfg, env: BaseEnv, policy: str | None = None, *, deterministic: bool = True
) -> Policy:
    """Return the policy by name, by import path, or from a training's folder or file.

    Args:
        root: The config.
        env: Where it will act.
        policy: Another one than the config's.
        deterministic: Whether a trained one takes its mean action.

    Raises:
        ConfigError: There is no such policy, its parameters are wrong, or it was trained in
            another task and ``allow_changed`` is not set.
    """

    def load(path: Path) -> Policy:
        from embodichain.learning.policy import load_policy

        changed = root.allow_changed
        return load_policy(path, env, deterministic=deterministic, allow_changed=changed)

    chosen = policy or root.policy or "random"
    if isinstance(chosen, str):
        return resolve_policy(chosen, load_file=load)
    return resolve_policy({"func": chosen.func, "params": chosen.params}, load_file=load)


def attach_log(run: Job, env: BaseEnv) -> McapRecorder | None:
    """Attach the log, unless the config wants none; closing the environment finishes it."""
    if run.root.record.format == "none":
        return None
    from embodichain.config.resolved import dump_yaml
    from embodichain.config.run_folder import LOG
    from embodichain.recording import McapRecorder

    recorder = McapRecorder(
        run.folder / LOG,
        env,
        config=dump_yaml(run.resolved.tree),
        overrides=dump_yaml(list(run.resolved.overrides)),
        options=run.root.record,
        task=run.resolved.task_name,
    )
    env.add_observer(recorder)
    return recorder


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
        realtime: Whether the run initially keeps to real time while the viewer is watched.
        resets: Whether the viewer may end an episode.
    """
    viewer = root.viewer
    if viewer.name not in ("web", "foxglove"):
        return
    if viewer.name == "foxglove":
        from embodichain.recording.viewers.foxglove import FoxgloveView

        shown = sorted({viewer.env, *root.record.view_envs})
        live = FoxgloveView(env, viewer.host, viewer.port, shown, realtime=realtime)
        env.add_observer(live)
        url = live.server.url
        where = f"{url} (Foxglove, Lichtblick: Open connection, Foxglove WebSocket)"
    else:
        from embodichain.recording.viewers.web import PageOptions, WebView

        page = PageOptions(viewer.host, viewer.port, viewer.env, realtime, resets)
        view = WebView(env, page, stopped=stop.is_stopped)
        env.add_observer(view)
        url = where = view.url
    logging.getLogger(__name__).info("viewer: %s", where)
    if not root.quiet and not root.json:
        sys.stderr.write(f"viewer: {where}\n")
    warn_if_public(viewer.host, url, controls=viewer.name == "web")


def warn_if_public(host: str, url: str, *, controls: bool) -> None:
    """Warn on stderr if other machines can reach a viewer.

    Args:
        host: The address it listens on.
        url: Where it is; has the port.
        controls: Whether a viewer can control the run.
    """
    from embodichain.utils.addresses import is_loopback

    if not is_loopback(host):
        use = " and use its controls" if controls else ""
        sys.stderr.write(
            f"warning: the viewer at {host}:{urlsplit(url).port} has no authentication; "
            f"anyone who can reach this address can watch the run{use}\n"
        )


class StartPicture:
    """The state of environment 0 at the moment of construction.

    Args:
        env: An environment that was reset.
    """

    def __init__(self, env: BaseEnv) -> None:
        self._model = env.sim.scene.model
        self._data = env.sim.engine.data_of(0)

    def data_of(self, env_id: int) -> mujoco.MjData:
        """The kept state."""
        return self._data

    def draw(self, path: Path) -> None:
        """Write the picture; a machine without OpenGL only warns."""
        from PIL import Image

        from embodichain.lab.sim.rendering import SceneRenderer
        from embodichain.utils.atomic import atomic_file
        from embodichain.utils.errors import RenderError

        try:
            renderer = SceneRenderer(self._model, *_SIZE)
            pixels = renderer.draw(self, 0, "default")
            renderer.close()
        except RenderError as error:
            _log.warning("no scene.png: %s", error)
            return
        try:
            with atomic_file(path) as temporary:
                Image.fromarray(pixels).save(temporary, format="PNG")
        except OSError as error:
            _log.warning("no scene.png: %s", error)


def show_pictures(display: ProgressDisplay) -> Callable[[Filmed], None]:
    """Return what shows how far a film is."""

    def show(filmed: Filmed) -> None:
        if display.due:
            display.show(filmed.pictures, {"step": f"{filmed.step}"})

    return show


def ended_early(stop: StopFlag, filmed: Filmed, out: Path) -> str:
    """Say what a film holds that a signal ended."""
    if not filmed.pictures:
        return f"interrupted ({stop.stopped}); {out} was not begun"
    till = f"{filmed.pictures} pictures, up to control step {filmed.step}"
    return f"interrupted ({stop.stopped}); {out} is a whole film of the first {till}"


def film_job(run: Job, stop: StopFlag, log: str | Path | None) -> dict[str, str]:
    """Film what a job has logged, if its config says so; comes last, for all else is safe then.

    Args:
        run: The job.
        stop: Its flag ends the film after a picture, and begins none; that is a warning.
        log: Its log, finished; None without.

    Returns:
        ``video``, its path; nothing without a film. If a signal ended it, `stop` says so.

    Raises:
        RenderError: No picture can be drawn here.
    """
    if not run.root.video or log is None:
        return {}
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.recording.film import film_log

    out = run.folder / VIDEO
    with ProgressDisplay("film", None, "pictures", quiet=run.quiet) as display:
        filmed = film_log(log, out, progress=show_pictures(display), stop=stop.is_stopped)
    if filmed.whole:
        _log.info("%s: %d pictures", out, filmed.pictures)
    else:
        _log.warning("%s", ended_early(stop, filmed, out))
    return {"video": str(out)} if filmed.pictures else {}
