"""`LogViews`: what a log has for people: scenes, scalars, lines and pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.views.views import Sink, Views
from embodichain.utils.array_types import EnvIds

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.recording.views.images import Images
    from embodichain.recording.views.pictures import FirstPictures

__all__ = ["LogViews"]


class LogViews:
    """The channels of a log that viewers show.

    Args:
        env: The environment.
        options: The recorder's options.
        sink: Receives the messages.
        now_ns: Returns the log time in ns.

    Attributes:
        scenes: Scenes, scalars and lines of the viewed environments.
    """

    def __init__(
        self, env: ObservedEnv, options: RecordOptions, sink: Sink, now_ns: Callable[[], int]
    ) -> None:
        self._env_ids = [int(env_id) for env_id in options.view_envs]
        self.scenes = Views(env, options, sink, now_ns)
        self.scenes.say("recording begins")
        self._pictures = _pictures(env, options, sink, now_ns)

    def on_rows(self, step: int, rows: F64) -> None:
        """Sample the (N, nstate) rows before the physics of a control step."""
        self.scenes.on_rows(step, rows)
        for pictures in self._pictures:
            pictures.on_rows(step, rows)

    def on_reset(self, env_ids: EnvIds, recorded: bool) -> None:
        """After environments were reset.

        Args:
            env_ids: (n,) the environments.
            recorded: Whether steps are recorded at present.
        """
        for pictures in self._pictures:
            pictures.on_reset(env_ids)
        if recorded:
            self.scenes.on_reset(env_ids)

    def show_again(self) -> None:
        """Write whole scenes and pictures in the next step, for readers who begin there."""
        self.scenes.show(self._env_ids)
        for pictures in self._pictures:
            pictures.restart()


def _pictures(
    env: ObservedEnv, options: RecordOptions, sink: Sink, now_ns: Callable[[], int]
) -> list[FirstPictures | Images]:
    """What draws pictures for the log. Each module is imported only if it draws."""
    pictures: list[FirstPictures | Images] = []
    sensors = getattr(env.sim, "sensors", {})  # other classes may have none
    has_cameras = any(sensor.cfg.reads_images for sensor in sensors.values())
    if has_cameras and options.state != "none":
        from embodichain.recording.views.pictures import FirstPictures

        pictures.append(FirstPictures(env, sink, now_ns))
    if options.images is not None:
        from embodichain.recording.views.images import Images

        pictures.append(Images(env, options.images, sink, now_ns))
    return pictures
