"""Events that record videos of environments: one MP4 per episode."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Finite, Positive, Vec3
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.observers import ObservedEnv, StepObserver
from embodichain.utils.array_types import host_ids
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.video import VideoFile, need_encoder

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.drawing.views import View
    from embodichain.utils.array_types import EnvIds, EnvIndex

__all__ = ["RecordCameraData", "filmed_from"]

Pixels = Annotated[int, Field(ge=2, multiple_of=2)]
Intrinsics = Annotated[list[Finite], Field(min_length=4, max_length=4)]


@register_term("event", name="record_camera_data")
class RecordCameraData(Term):
    """Records images of environments, one MP4 for each episode of each environment.

    Needs `mode: interval`; with `interval_step: 1` every control step is an image. A file is
    finished when its environment is reset or the task is closed, and is named
    ``NAME_envI_episodeK.mp4``. EmbodiChain's event of the same name; it needs the extra `video`.

    Args:
        name: Prefix of the file names.
        resolution: [width, height] in pixels, both even; None is [640, 480].
        eye: Position of the camera, metres, environment's frame; None is [0, 0, 2].
        target: The point it looks at; None is the origin.
        up: The upward direction of the image; +x if it is parallel to the view. None is
            [0, 0, 1].
        intrinsics: [fx, fy, cx, cy] in pixels, the axis from the top left corner. None is a focal
            length of 600 and the axis in the middle.
        max_env_num: Number of recorded environments, from the first. Each has an encoder process.
        save_path: Folder; None is `videos` in the run's folder, or `outputs/videos` without one.
        camera: A camera of the scene, such as `default`, instead of `eye` and `target`.
        fps: Images per second of the video; None is the control frequency: real time with
            `interval_step: 1`.

    Example:
        ``{func: record_camera_data, mode: interval, interval_step: 1, params: {resolution: [320, 240], camera: default, max_env_num: 1}}``
    """  # noqa: E501  (an example is one line)

    watches = True
    whole_batch = "it names its videos by environments of one process; record.images has pictures"

    def __init__(
        self,
        env: TermContext,
        name: str = "default",
        resolution: Annotated[list[Pixels], Field(min_length=2, max_length=2)] | None = None,
        eye: Vec3 | None = None,
        target: Vec3 | None = None,
        up: Vec3 | None = None,
        intrinsics: Intrinsics | None = None,
        max_env_num: Annotated[int, Field(ge=1)] = 16,
        save_path: str | None = None,
        camera: str | None = None,
        fps: Positive | None = None,
    ) -> None:
        env.arrays.require_host("videos")
        need_encoder()
        if not name or Path(name).name != name:
            raise ConfigError([Problem("name", f"is not part of a file's name: {name!r}")])
        self._env = env
        self._name = name
        self._count = max_env_num
        width, height = resolution or (640, 480)
        self._size = (width, height)
        self._view: Callable[[], View]
        if camera is None:
            view = filmed_from(self._size, eye, target, up, intrinsics)
            self._view = lambda: view
        else:
            from embodichain.lab.sim.drawing.views import camera_id, view_of

            engine = env.sim.engine
            try:
                camera_number = camera_id(engine.model, camera)
            except ValueError as error:
                raise ConfigError([Problem("camera", str(error))]) from error
            self._view = partial(
                view_of, engine, camera_number, width, height, look="full", marks=True
            )
        self._folder = None if save_path is None else Path(save_path)
        self._fps = env.control_frequency if fps is None else fps
        self._videos: dict[int, VideoFile] = {}
        _finish_at_close(env, self)

    def __call__(self, env: TermContext, env_ids: EnvIds | None) -> None:
        """Render one image of each recorded environment."""
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        ids = ids[ids < self._count]
        if not len(ids):
            return
        (drawn,) = env.sim.draw([self._view()], ids)
        for i, picture in zip(ids.tolist(), drawn["color"][..., :3], strict=True):
            if i not in self._videos:
                file_name = f"{self._name}_env{i}_episode{int(env.episode_ids[i])}.mp4"
                self._videos[i] = VideoFile(self._video_folder() / file_name, self._size, self._fps)
            self._videos[i].write(picture)

    def _video_folder(self) -> Path:
        """The folder of the files; a run's folder may be set after this term is built."""
        if self._folder is not None:
            return self._folder
        if self._env.run_dir is None:
            return Path("outputs/videos")
        return self._env.run_dir / "videos"

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Finish the files of these environments' episodes."""
        ids = list(self._videos) if env_ids is None else host_ids(env_ids).tolist()
        for i in ids:
            video = self._videos.pop(i, None)
            if video is not None:
                video.close()


def filmed_from(
    size: tuple[int, int],
    eye: list[float] | None = None,
    target: list[float] | None = None,
    up: list[float] | None = None,
    intrinsics: list[float] | None = None,
) -> View:
    """The view of `record_camera_data`, from its parameters and their defaults.

    Raises:
        ConfigError: If the focal lengths are not positive, or the eye is at the target.
    """
    from embodichain.lab.sim.drawing.views import Optics, View, Viewpoint

    width, height = size
    fx, fy, cx, cy = intrinsics or [600.0, 600.0, width / 2, height / 2]
    if min(fx, fy) <= 0:
        message = f"focal lengths must be positive, got {fx} and {fy}"
        raise ConfigError([Problem("intrinsics", message)])
    try:
        viewpoint = Viewpoint.look_at(eye or [0, 0, 2], target or [0, 0, 0], up or [0, 0, 1])
    except ValueError as error:
        raise ConfigError([Problem("target", str(error))]) from error
    optics = Optics(width, height, (fx, fy), (cx, cy))
    return View(
        optics=optics,
        position=viewpoint.position,
        axes=viewpoint.axes,
        look="full",
        marks=True,
    )


def _finish_at_close(env: TermContext, term: RecordCameraData) -> None:
    """Finish the files of a term when the environment closes."""

    class Finisher(StepObserver):
        def on_close(self, env: ObservedEnv) -> None:
            term.reset(None)

    env.add_observer(Finisher())
