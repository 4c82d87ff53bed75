"""Pictures of recorded states, and the hashes of each episode's first pictures.

The state is that before the physics of a control step, so a log has all of it: rows, model fields
and cameras. Pictures of one machine and driver are equal to the byte; those of others may differ.
"""

from __future__ import annotations

import copy
import hashlib
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from google.protobuf.message import DecodeError
from mujoco.batch import MODEL_FIELDS

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer, hint_at_colors
from embodichain.lab.sim.drawing.states import DataState
from embodichain.lab.sim.drawing.views import Look, Output, Pictures, View, view_of
from embodichain.lab.sim.engine.api import F64, Engine
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.messages.schema import PICTURES_TOPIC, message_class
from embodichain.recording.format.options import LARGEST_SIDE
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.simulation import Simulation, always, never
from embodichain.recording.read.trajectory import follow
from embodichain.utils.array_types import EnvIds
from embodichain.utils.errors import RenderError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.sensors.camera import Camera
    from embodichain.recording.views.views import Sink

__all__ = ["FirstPictures", "RowRenderer", "Shot", "camera_sensors", "compare", "shots_of"]

_PREFIXES = ("geom_", "mat_", "light_", "cam_", "body_", "jnt_", "qpos0")
_VISIBLE_FIELDS = tuple(sorted(name for name in MODEL_FIELDS if name.startswith(_PREFIXES)))
"""The model fields that pictures depend on and that can differ between environments."""
_OUTPUTS: tuple[Output, ...] = ("color", "depth", "mask")
_LOOKS: tuple[Look, ...] = ("fast", "full")
_DIGEST_BYTES = 32
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Shot:
    """How a camera of the scene is drawn.

    Attributes:
        camera: Its name in the model.
        width: Pixels.
        height: Pixels.
        near: Metres along its axis.
        far: Metres along its axis.
        look: ``fast`` or ``full``.
        outputs: Some of ``color``, ``depth`` and ``mask``.
    """

    camera: str
    width: int
    height: int
    near: float
    far: float
    look: Look
    outputs: tuple[Output, ...]


def camera_sensors(env: ObservedEnv) -> list[Camera]:
    """The scene's camera sensors."""
    sensors = getattr(env.sim, "sensors", {})  # other classes may have none
    cameras: list[Any] = [s for s in sensors.values() if s.cfg.reads_images]
    return cameras


def shots_of(sensor: Camera) -> dict[str, Shot]:
    """How a camera sensor is drawn, by the name of the picture: one shot, or left and right."""
    cfg = sensor.cfg
    model = sensor.engine.model
    index = sensor.index
    shots = {}
    for name, camera in zip(index.pictures, index.ids, strict=True):
        shots[name] = Shot(
            camera=model.camera(camera).name,
            width=cfg.width,
            height=cfg.height,
            near=cfg.near,
            far=cfg.far,
            look=cfg.look,
            outputs=sensor.outputs,
        )
    return shots


class RowRenderer:
    """Draws single environments of an engine from state rows; the engine is not changed.

    OpenGL is loaded with the first picture.

    Args:
        engine: The engine; its model fields are read.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._model = copy.copy(engine.model)
        self._data = mujoco.MjData(self._model)
        layout = row_layout(self._model)
        # Arrays of `self._data` that kinematics reads, and their columns in a row.
        self._inputs: list[tuple[F64, slice]] = []
        for name in ("qpos", "mocap_pos", "mocap_quat"):
            values = getattr(self._data, name)
            if values.size:
                self._inputs.append((values.reshape(-1), layout[name]))
        self._renderer: OffscreenRenderer | None = None

    def open(self) -> OffscreenRenderer:
        """Open the renderer, if that has not been done.

        Raises:
            RenderError: If there is no OpenGL here.
        """
        if self._renderer is None:
            renderer = OffscreenRenderer(self._engine.model)
            if "color" not in renderer.outputs:
                raise RenderError(f"pictures of a log need OpenGL; {hint_at_colors()}")
            self._renderer = renderer
        return self._renderer

    @property
    def about(self) -> str:
        """The renderer, as the driver names it; RenderError if there is no OpenGL here."""
        renderer = self.open()
        return f"{renderer.kind}: {renderer.about}"

    def pose(self, env_id: int, row: F64) -> DataState:
        """Compute the poses of an environment; valid until the next call.

        Args:
            env_id: The environment, whose model fields are used.
            row: (nstate,) state.
        """
        for name in _VISIBLE_FIELDS:
            values = self._engine.model_values(name)
            # A field that is the same in all environments has one row.
            row_of_env = env_id if len(values) > 1 else 0
            getattr(self._model, name)[...] = values[row_of_env]
        for target, columns in self._inputs:
            target[:] = row[columns]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        return DataState(self._data)

    def draw(self, env_id: int, row: F64, shots: Sequence[Shot]) -> list[tuple[View, Pictures]]:
        """Draw an environment; each output has one row, and a shot may have none.

        Args:
            env_id: The environment, whose model fields are used.
            row: (nstate,) state.
            shots: How it is drawn.

        Raises:
            RenderError: If there is no OpenGL here.
            ValueError: If there is no such camera.
        """
        state = self.pose(env_id, row)
        views = [
            view_of(
                state,
                shot.camera,
                shot.width,
                shot.height,
                near=shot.near,
                far=shot.far,
                outputs=shot.outputs,
                look=shot.look,
            )
            for shot in shots
        ]
        views_with_outputs = [view for view in views if view.outputs]
        pictures: Iterator[Pictures] = iter(())
        if views_with_outputs:  # otherwise OpenGL is not needed
            pictures = iter(self.open().draw(state, views_with_outputs))
        return [(view, next(pictures) if view.outputs else {}) for view in views]

    def digests(self, env_id: int, row: F64, shots: Sequence[Shot]) -> list[bytes]:
        """SHA-256 of each shot: of its outputs one after another, in the order of the shot."""
        digests = []
        for shot, (_, pictures) in zip(shots, self.draw(env_id, row, shots), strict=True):
            digest = hashlib.sha256()
            for output in shot.outputs:
                digest.update(pictures[output].tobytes())
            digests.append(digest.digest())
        return digests


class FirstPictures:
    """Hashes the first pictures of episodes, for the cameras that something reads.

    Without OpenGL, where cameras have depth and masks only, there are none, and a warning says so.

    Args:
        env: The environment.
        sink: Receives the messages.
        now: Returns the log time in ns.
    """

    def __init__(self, env: ObservedEnv, sink: Sink, now: Callable[[], int]) -> None:
        self._engine = env.sim.engine
        self._cameras = camera_sensors(env)
        self._sink = sink
        self._now = now
        self._begun: set[int] = set()
        self._renderer: RowRenderer | None = None
        self._is_off = False
        sink.channel(PICTURES_TOPIC, "embodichain.Pictures")

    def restart(self) -> None:
        """Do nothing: messages need none before them."""

    def on_reset(self, env_ids: EnvIds) -> None:
        """Note that episodes of these environments begin."""
        self._begun.update(env_ids.tolist())

    def on_rows(self, step: int, rows: F64) -> None:
        """Write the hashes of episodes that begin with a control step.

        Args:
            step: The control step.
            rows: (N, nstate) rows before its physics.
        """
        env_ids = sorted(self._begun)
        self._begun = set()
        shots: list[Shot] = []
        for camera in self._cameras:
            if camera.was_drawn:
                shots += shots_of(camera).values()
        if not env_ids or not shots or self._is_off:
            return
        if self._renderer is None:
            try:
                self._renderer = RowRenderer(self._engine)
                self._renderer.open()
            except RenderError as error:
                self._is_off = True
                _log.warning("the log has no hashes of pictures: %s", error)
                return
        digests = [self._renderer.digests(env_id, rows[env_id], shots) for env_id in env_ids]
        for index, shot in enumerate(shots):
            message = message_class("Pictures")(
                step=step,
                **asdict(shot),
                renderer=self._renderer.about,
                env_ids=env_ids,
                sha256=b"".join(env_digests[index] for env_digests in digests),
            )
            self._sink.send(self._now(), [(PICTURES_TOPIC, message.SerializeToString())])


class _HashedPictures(NamedTuple):
    """A message of `PICTURES_TOPIC`.

    Attributes:
        step: The control step before whose physics the pictures were drawn.
        shot: How they were drawn.
        renderer: What drew them.
        digests: Environment to the digest of its picture.
    """

    step: int
    shot: Shot
    renderer: str
    digests: dict[int, bytes]


def _read_hashes(reader: LogReader) -> Iterator[_HashedPictures]:
    for topic, _, payload in reader.messages():
        if topic == PICTURES_TOPIC:
            try:
                yield _decode_hashes(bytes(payload))
            except DamageError as error:
                raise LogError(f"{reader.path}: a message is damaged: {error}") from error


def _decode_hashes(data: bytes) -> _HashedPictures:
    try:
        message = message_class("Pictures").FromString(data)
    except DecodeError as error:
        raise DamageError(f"hashes of pictures are damaged: {error}") from error
    shot = Shot(
        camera=message.camera,
        width=message.width,
        height=message.height,
        near=message.near,
        far=message.far,
        look=message.look,
        outputs=tuple(message.outputs),
    )
    has_digests = len(message.sha256) == _DIGEST_BYTES * len(message.env_ids)
    if not has_digests or not _can_be_drawn(shot):
        raise DamageError("hashes of pictures are damaged")
    digests = {}
    for index, env_id in enumerate(message.env_ids):
        start = index * _DIGEST_BYTES
        digests[env_id] = message.sha256[start : start + _DIGEST_BYTES]
    return _HashedPictures(message.step, shot, renderer=message.renderer, digests=digests)


def _can_be_drawn(shot: Shot) -> bool:
    """Whether the values of a shot are possible; its camera may not exist."""
    if not 0 < shot.width <= LARGEST_SIDE or not 0 < shot.height <= LARGEST_SIDE:
        return False
    if shot.look not in _LOOKS or not shot.outputs or set(shot.outputs) - set(_OUTPUTS):
        return False
    return 0 < shot.near < shot.far < np.inf


def compare(
    reader: LogReader, model: mujoco.MjModel, env: int | None = None
) -> tuple[int, list[str]]:
    """Draw the first pictures of episodes again, and compare their hashes with the recorded ones.

    Args:
        reader: The log.
        model: The recorded model.
        env: Only this environment; None is all.

    Returns:
        Number of equal pictures, and why the pictures are not all equal, one line each.

    Raises:
        LogError: If the log is damaged.
        RenderError: If nothing can be drawn here.
    """
    header = reader.require_header()
    hashed: dict[int, list[_HashedPictures]] = {}  # by control step
    renderers: set[str] = set()
    for recorded in _read_hashes(reader):
        hashed.setdefault(recorded.step, []).append(recorded)
        renderers.add(recorded.renderer)
    if not hashed:
        return 0, ["the log has no hashes of pictures: no camera was read"]
    env_ids = np.arange(header.num_envs) if env is None else np.array([env])
    # States are taken from the log; only those between keyframes are simulated.
    active = always(len(env_ids)) if header.keyframe_every else never(len(env_ids))
    simulation = Simulation(reader, model, env_ids=env_ids, active=active, num_threads=1)
    renderer = RowRenderer(simulation.engine)
    other_renderers = sorted(renderers - {renderer.about})
    if other_renderers:
        names = ", ".join(other_renderers)
        return 0, [f"pictures were drawn by {names}; here by {renderer.about}: not comparable"]
    num_equal = 0
    for run, t in follow(reader, simulation):
        for recorded in hashed.pop(run.first + t, ()):
            for local, env_id in enumerate(env_ids.tolist()):
                if env_id not in recorded.digests:
                    continue
                digest = _digest(renderer, local, simulation, recorded.shot, reader)
                if digest != recorded.digests[env_id]:
                    problem = (
                        f"step {recorded.step}, environment {env_id}, camera "
                        f"{recorded.shot.camera}: the picture differs from the recorded one"
                    )
                    return num_equal, [problem]
                num_equal += 1
    if hashed:
        step = min(hashed)
        return num_equal, [f"the log has hashes of pictures of control step {step}, but lacks it"]
    return num_equal, []


def _digest(
    renderer: RowRenderer, local: int, simulation: Simulation, shot: Shot, reader: LogReader
) -> bytes:
    try:
        (digest,) = renderer.digests(local, simulation.rows[local], [shot])
    except ValueError as error:
        raise LogError(f"{reader.path}: a message is damaged: {error}") from error
    return digest
