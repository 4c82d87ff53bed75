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
from embodichain.lab.sim.engine.api import F64, EnvIndex
from embodichain.recording.format.options import ImageOptions
from embodichain.recording.views.encoders import Encoder, encoder_of
from embodichain.recording.views.pictures import RowRenderer, Shot, camera_sensors, shots_of
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
    """One camera of one environment: its frame and topics, and the encoder of its colours."""

    env_id: int
    name: str
    shot: Shot
    frame: str
    encode: Encoder

    def topic(self, name: str) -> str:
        """Topic of an output, or of the calibration."""
        return f"/{self.frame}/{'image' if name == 'color' else name}"


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
        self._wanted = wanted or (lambda topic: True)
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
        video = options.format == "h264"
        image = "foxglove.CompressedVideo" if video else "foxglove.CompressedImage"
        sink.channel("/tf", "foxglove.FrameTransforms")
        for feed in self._feeds:
            sink.channel(feed.topic("calibration"), "foxglove.CameraCalibration")
            for output in feed.shot.outputs:
                sink.channel(
                    feed.topic(output), image if output == "color" else "foxglove.RawImage"
                )

    def restart(self) -> None:
        """Begin new videos, so that the next pictures need none before them."""
        how = self._options.format
        self._feeds = [
            _Feed(
                env_id,
                name,
                shot,
                _frame(env_id, name),
                encoder_of(how, shot.width, shot.height, self._rate),
            )
            for env_id in self._env_ids
            for name, shot in self._shots.items()
        ]

    def on_reset(self, env_ids: EnvIndex) -> None:
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
            outputs = [tuple(o for o in f.shot.outputs if self._wanted(f.topic(o))) for f in feeds]
            posed = self._wanted("/tf") or any(self._wanted(f.topic("calibration")) for f in feeds)
            if not posed and not any(outputs):
                continue
            shots = [replace(f.shot, outputs=o) for f, o in zip(feeds, outputs, strict=True)]
            drawn = self._renderer.draw(env_id, rows[env_id], shots)
            time_ns = self._now()
            messages = [
                (topic, message.SerializeToString())
                for feed, (view, pictures) in zip(feeds, drawn, strict=True)
                for topic, message in self._messages(feed, view, pictures, time_ns)
            ]
            self._sink.send(time_ns, messages)

    def _messages(
        self, feed: _Feed, view: View, pictures: Pictures, time_ns: int
    ) -> Iterator[tuple[str, Any]]:
        how = self._options.format
        made: list[tuple[str, Any]] = [("calibration", _calibration(feed.shot, view))]
        if "color" in pictures:
            data = feed.encode(np.ascontiguousarray(pictures["color"][0, ..., :3]))
            kind = CompressedVideo if how == "h264" else CompressedImage
            made.append(("color", kind(data=data, format=how)))
        if "depth" in pictures:
            made.append(("depth", _numbers(_depth(pictures["depth"][0]))))
        if "mask" in pictures:
            entities = self._entities[feed.name][pictures["mask"][0]]
            values = np.where(entities < 0, _BACKGROUND, entities).astype(np.uint16)
            made.append(("mask", _numbers(values)))
        for name, message in made:
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
    ids = sorted(set(options.envs))
    coloured = [name for name, shot in shots.items() if "color" in shot.outputs]
    return [f"/{_frame(i, name)}/image" for i in ids for name in coloured]


def _frame(env_id: int, name: str) -> str:
    return f"env_{env_id}/camera/{name}"


def _shots(env: ObservedEnv, cameras: list[Camera], options: ImageOptions) -> dict[str, Shot]:
    """How the wanted cameras are drawn, by the name of the picture.

    Raises:
        ConfigError: If there is none, or one cannot be recorded in this way.
    """
    model = env.sim.engine.model
    known = {name: shot for sensor in cameras for name, shot in shots_of(sensor).items()}
    names = list(known) if options.cameras is None else list(dict.fromkeys(options.cameras))
    sensors = {
        name: (int(model.camera(shot.camera).id), (shot.width, shot.height))
        for name, shot in known.items()
    }
    problems = check_images(options, model, sensors)
    if problems:
        raise ConfigError(problems)
    known = {model.camera(i).name: _scene_shot(model, i) for i in range(model.ncam)} | known
    if options.size is None:
        return {name: known[name] for name in names}
    width, height = options.size
    return {name: replace(known[name], width=width, height=height) for name in names}


def _scene_shot(model: mujoco.MjModel, camera: int) -> Shot:
    """How a camera of the scene that is no sensor is drawn: in full look."""
    width, height = camera_size(model, camera)
    extent = float(model.stat.extent)
    planes = model.vis.map
    near = float(planes.znear) * extent
    far = float(planes.zfar) * extent
    return Shot(model.camera(camera).name, width, height, near, far, "full", ("color",))


def _depth(metres: NDArray[np.float32]) -> NDArray[np.uint16]:
    millimetres = np.rint(metres * _MILLIMETRES)
    return np.where(millimetres < 2**16, millimetres, 0).astype(np.uint16)


def _numbers(values: NDArray[np.uint16]) -> Any:
    """(H, W) numbers as an image; viewers reduce a PNG of 16 bits to 8."""
    height, width = values.shape
    data = values.astype("<u2").tobytes()
    size = {"width": width, "height": height, "step": 2 * width}
    return RawImage(**size, encoding="16UC1", data=data)


def _calibration(shot: Shot, view: View) -> Any:
    """The lens as OpenCV and ROS count pixels: the middle of the first one is at (0, 0)."""
    fx, fy, *middle = view.lens[0].tolist()
    cx, cy = (place - 0.5 for place in middle)
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
    x, y, z = view.position[0].tolist()
    quat = matrix_to_quat(np.asarray(view.axes, np.float64)[:1] * _ROS_AXES)[0]
    frame.translation.x = x
    frame.translation.y = y
    frame.translation.z = z
    rotation = frame.rotation
    rotation.w, rotation.x, rotation.y, rotation.z = quat.tolist()
    return message
