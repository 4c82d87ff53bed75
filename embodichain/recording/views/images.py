"""`Images`: pictures of cameras in a log (`record.images`), as viewers show them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from numpy.typing import NDArray

from embodichain.config.checks.recorded_images import check_images
from embodichain.lab.sim.drawing.views import Pictures, View, camera_size
from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.options import ImageOptions
from embodichain.recording.views.encoders import Encoder, encoder_of
from embodichain.recording.views.pictures import RowRenderer, Shot, camera_sensors, shots_of
from embodichain.utils.array_types import EnvIds
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import matrix_to_quat

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.sensors.camera import Camera
    from embodichain.recording.views.views import Sink

__all__ = ["Images", "image_topics"]

_BACKGROUND = 65535
"""Value of the background in masks."""
_MILLIMETRES = 1000.0
_ROS_AXES = np.array([1.0, -1.0, -1.0])
"""Signs of OpenGL's axes as columns of ROS's optical frame: x right, y down, z forward."""


class _Feed(NamedTuple):
    """One camera of one environment.

    Attributes:
        env_id: The environment.
        name: Name of the picture.
        shot: How it is drawn.
        frame: Name of the camera's frame.
        encode: Encoder of its colours.
    """

    env_id: int
    name: str
    shot: Shot
    frame: str
    encode: Encoder

    def topic(self, name: str) -> str:
        """Topic of an output, or of the calibration."""
        if name == "color":
            name = "image"
        return f"/{self.frame}/{name}"


class Images:
    """Draws cameras of some environments and writes their pictures.

    The topics of a camera are ``/env_I/camera/NAME/`` with ``image``, ``depth``, ``mask`` and
    ``calibration``, in OpenCV's and ROS's pixels, whose middles are whole numbers; its frame
    ``env_I/camera/NAME`` has ROS's optical axes. Depth is in
    millimetres, 0 where nothing is hit or beyond 65.5 m; masks have the sensor's numbers of
    entities, and 65535 for the background.

    Args:
        env: The environment.
        options: Which cameras and environments, how often, and in which format.
        sink: Receives the messages.
        now: Returns the log time in ns.
        wanted: Whether a topic has a receiver; only these are drawn, and OpenGL is loaded with the
            first picture. None: all topics have one.

    Raises:
        ConfigError: If there is no such camera, or a package is missing.
        RenderError: If nothing can be drawn here and `wanted` is None.
    """

    def __init__(
        self,
        env: ObservedEnv,
        options: ImageOptions,
        sink: Sink,
        now: Callable[[], int],
        wanted: Callable[[str], bool] | None = None,
    ) -> None:
        self._options = options
        self._sink = sink
        self._now = now
        self._is_wanted = wanted or (lambda topic: True)
        self._env_ids = sorted(set(options.envs))
        cameras = camera_sensors(env)
        self._shots = _shots(env, cameras, options)
        self._entities = {name: c.index.entity_of_geom for c in cameras for name in shots_of(c)}
        period = 1.0 / (options.rate * float(env.step_dt))
        self._every = max(1, math.ceil(period - 1e-9))
        self._rate = 1.0 / (self._every * float(env.step_dt))
        self._due: set[int] = set()
        self._feeds: list[_Feed] = []
        self._renderer = RowRenderer(env.sim.engine)
        if wanted is None:
            self._renderer.open()
        self.restart()
        sink.channel("/tf", "foxglove.FrameTransforms")
        for feed in self._feeds:
            sink.channel(feed.topic("calibration"), "foxglove.CameraCalibration")
            for output in feed.shot.outputs:
                if output != "color":
                    schema = "foxglove.RawImage"
                elif options.format == "h264":
                    schema = "foxglove.CompressedVideo"
                else:
                    schema = "foxglove.CompressedImage"
                sink.channel(feed.topic(output), schema)

    def restart(self) -> None:
        """Begin new videos, so that the next pictures need none before them."""
        self._feeds = []
        for env_id in self._env_ids:
            for name, shot in self._shots.items():
                encode = encoder_of(self._options.format, shot.width, shot.height, self._rate)
                feed = _Feed(
                    env_id=env_id,
                    name=name,
                    shot=shot,
                    frame=_frame(env_id, name),
                    encode=encode,
                )
                self._feeds.append(feed)

    def on_reset(self, env_ids: EnvIds) -> None:
        """Draw these environments in the next step."""
        self._due.update(env_ids.tolist())

    def on_rows(self, step: int, rows: F64) -> None:
        """Draw the environments if their pictures are due, or after a reset.

        Args:
            step: The control step before its physics.
            rows: (N, nstate) rows.
        """
        all_due = step % self._every == 0
        due = self._due
        self._due = set()
        self.send(rows, [i for i in self._env_ids if all_due or i in due])

    def send(self, rows: F64, env_ids: Sequence[int] | None = None) -> None:
        """Draw environments as they are now.

        Args:
            rows: (N, nstate) rows.
            env_ids: Which of those in the options; None is all.

        Raises:
            RenderError: If an output cannot be drawn here.
        """
        for env_id in self._env_ids if env_ids is None else env_ids:
            feeds = [feed for feed in self._feeds if feed.env_id == env_id]
            shots = [self._wanted_shot(feed) for feed in feeds]
            draws_any = any(shot.outputs for shot in shots)
            if not draws_any and not self._wants_poses(feeds):
                continue
            drawn = self._renderer.draw(env_id, rows[env_id], shots)
            time_ns = self._now()
            messages = []
            for feed, (view, pictures) in zip(feeds, drawn, strict=True):
                for topic, message in self._messages(feed, view, pictures, time_ns):
                    messages.append((topic, message.SerializeToString()))
            self._sink.send(time_ns, messages)

    def _wanted_shot(self, feed: _Feed) -> Shot:
        """How a camera is drawn for the topics that have a receiver."""
        outputs = [name for name in feed.shot.outputs if self._is_wanted(feed.topic(name))]
        return replace(feed.shot, outputs=tuple(outputs))

    def _wants_poses(self, feeds: Sequence[_Feed]) -> bool:
        """Whether the place or the lens of a camera has a receiver."""
        topics = ["/tf", *(feed.topic("calibration") for feed in feeds)]
        return any(self._is_wanted(topic) for topic in topics)

    def _messages(
        self, feed: _Feed, view: View, pictures: Pictures, time_ns: int
    ) -> Iterator[tuple[str, Any]]:
        """Yield topic and message of a camera's calibration, pictures and place."""
        messages: dict[str, Any] = {"calibration": _calibration(feed.shot, view)}
        if "color" in pictures:
            data = feed.encode(np.ascontiguousarray(pictures["color"][0, ..., :3]))
            format_name = self._options.format
            message_type = CompressedVideo if format_name == "h264" else CompressedImage
            messages["color"] = message_type(data=data, format=format_name)
        if "depth" in pictures:
            messages["depth"] = _raw_image(_depth(pictures["depth"][0]))
        if "mask" in pictures:
            entities = self._entities[feed.name][pictures["mask"][0]]
            values = np.where(entities < 0, _BACKGROUND, entities).astype(np.uint16)
            messages["mask"] = _raw_image(values)
        for name, message in messages.items():
            message.frame_id = feed.frame
            message.timestamp.FromNanoseconds(time_ns)
            yield feed.topic(name), message
        yield "/tf", _transform(feed, view, time_ns)


def image_topics(env: ObservedEnv, options: ImageOptions) -> list[str]:
    """Topics of the coloured pictures.

    Raises:
        ConfigError: If there is no such camera.
    """
    shots = _shots(env, camera_sensors(env), options)
    names = [name for name, shot in shots.items() if "color" in shot.outputs]
    topics = []
    for env_id in sorted(set(options.envs)):
        topics += [f"/{_frame(env_id, name)}/image" for name in names]
    return topics


def _frame(env_id: int, name: str) -> str:
    return f"env_{env_id}/camera/{name}"


def _shots(env: ObservedEnv, cameras: list[Camera], options: ImageOptions) -> dict[str, Shot]:
    """How the wanted cameras are drawn, by the name of the picture.

    Raises:
        ConfigError: If there is no such camera, or one cannot be recorded in this way.
    """
    model = env.sim.engine.model
    sensor_shots: dict[str, Shot] = {}
    for sensor in cameras:
        sensor_shots |= shots_of(sensor)
    sensors = {
        name: (int(model.camera(shot.camera).id), (shot.width, shot.height))
        for name, shot in sensor_shots.items()
    }
    problems = check_images(options, model, sensors)
    if problems:
        raise ConfigError(problems)
    # A sensor comes before a camera of the scene with the same name.
    shots = {model.camera(i).name: _scene_shot(model, i) for i in range(model.ncam)}
    shots |= sensor_shots
    names = sensor_shots if options.cameras is None else dict.fromkeys(options.cameras)
    if options.size is None:
        return {name: shots[name] for name in names}
    width, height = options.size
    return {name: replace(shots[name], width=width, height=height) for name in names}


def _scene_shot(model: mujoco.MjModel, camera: int) -> Shot:
    """How a camera of the scene is drawn that is not a sensor: in full look."""
    width, height = camera_size(model, camera)
    extent = float(model.stat.extent)
    return Shot(
        camera=model.camera(camera).name,
        width=width,
        height=height,
        near=float(model.vis.map.znear) * extent,
        far=float(model.vis.map.zfar) * extent,
        look="full",
        outputs=("color",),
    )


def _depth(metres: NDArray[np.float32]) -> NDArray[np.uint16]:
    millimetres = np.rint(metres * _MILLIMETRES)
    return np.where(millimetres < 2**16, millimetres, 0).astype(np.uint16)


def _raw_image(values: NDArray[np.uint16]) -> Any:
    """(H, W) numbers as an image without compression: viewers reduce a PNG of 16 bits to 8."""
    height, width = values.shape
    return RawImage(
        width=width,
        height=height,
        step=2 * width,
        encoding="16UC1",
        data=values.astype("<u2").tobytes(),
    )


def _calibration(shot: Shot, view: View) -> Any:
    """The lens as OpenCV and ROS count pixels: the middle of the first one is at (0, 0)."""
    fx, fy, cx, cy = view.lens[0].tolist()
    cx -= 0.5
    cy -= 0.5
    return CameraCalibration(
        width=shot.width,
        height=shot.height,
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _transform(feed: _Feed, view: View, time_ns: int) -> Any:
    """The camera's frame in that of its environment, with ROS's optical axes."""
    message = FrameTransforms()
    frame = message.transforms.add(parent_frame_id=f"env_{feed.env_id}", child_frame_id=feed.frame)
    frame.timestamp.FromNanoseconds(time_ns)
    translation = frame.translation
    translation.x, translation.y, translation.z = view.position[0].tolist()
    quat = matrix_to_quat(np.asarray(view.axes, np.float64)[:1] * _ROS_AXES)[0]
    rotation = frame.rotation
    rotation.w, rotation.x, rotation.y, rotation.z = quat.tolist()
    return message
