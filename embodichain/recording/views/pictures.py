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

from embodichain.lab.sim.drawing.gl import hint
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import DataState
from embodichain.lab.sim.drawing.views import Look, Output, Pictures, View, view_of
from embodichain.lab.sim.engine.api import F64, Engine, EnvIndex
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.options import LARGEST_SIDE
from embodichain.recording.format.schema import PICTURES_TOPIC, message_class
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.simulation import Simulation, always, never
from embodichain.recording.read.trajectory import follow
from embodichain.utils.errors import RenderError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.sensors.camera import Camera
    from embodichain.recording.views.views import Sink

__all__ = ["FirstPictures", "RowRenderer", "Shot", "camera_sensors", "compare", "shots_of"]

_PREFIXES = ("geom_", "mat_", "light_", "cam_", "body_", "jnt_", "qpos0")
_DRAWN = tuple(sorted(name for name in MODEL_FIELDS if name.startswith(_PREFIXES)))
"""The model fields that pictures depend on and that can differ between environments."""
_OUTPUTS: tuple[Output, ...] = ("color", "depth", "mask")
_LOOKS: tuple[Look, ...] = ("fast", "full")
_DIGEST = 32
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
        outputs: ``color``, ``depth`` and ``mask``, as wanted.
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
    cfg, model, index = sensor.cfg, sensor.engine.model, sensor.index
    how = cfg.width, cfg.height, cfg.near, cfg.far, cfg.look, sensor.outputs
    return {
        name: Shot(model.camera(camera).name, *how)
        for name, camera in zip(index.pictures, index.ids, strict=True)
    }


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
        inputs = {name: getattr(self._data, name) for name in ("qpos", "mocap_pos", "mocap_quat")}
        self._inputs = [(a.reshape(-1), layout[name]) for name, a in inputs.items() if a.size]
        self._opened: OffscreenRenderer | None = None

    def open(self) -> OffscreenRenderer:
        """Open the renderer, if that has not been done.

        Raises:
            RenderError: If there is no OpenGL here.
        """
        if self._opened is None:
            opened = OffscreenRenderer(self._engine.model)
            if opened.kind == "rays":
                raise RenderError(f"pictures of a log need OpenGL; {hint()}")
            self._opened = opened
        return self._opened

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
        for name in _DRAWN:
            values = self._engine.model_values(name)
            getattr(self._model, name)[...] = values[env_id if len(values) > 1 else 0]
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
            shots: How.

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
        drawn = [view for view in views if view.outputs]
        pictures = iter(self.open().draw(state, drawn) if drawn else [])
        return [(view, next(pictures) if view.outputs else {}) for view in views]

    def digests(self, env_id: int, row: F64, shots: Sequence[Shot]) -> list[bytes]:
        """SHA-256 of each shot: of its outputs one after another, in the order of the shot."""
        found = []
        for shot, (_, pictures) in zip(shots, self.draw(env_id, row, shots), strict=True):
            digest = hashlib.sha256()
            for output in shot.outputs:
                digest.update(pictures[output].tobytes())
            found.append(digest.digest())
        return found


class FirstPictures:
    """Hashes the first pictures of episodes, for the cameras that something reads.

    Without OpenGL, where cameras have depth and masks only, there are none, and a warning says so.

    Args:
        env: The environment.
        sink: Receives the messages.
        now: Returns the log time in ns.
    """

    def __init__(self, env: ObservedEnv, sink: Sink, now: Callable[[], int]) -> None:
        self._engine, self._cameras = env.sim.engine, camera_sensors(env)
        self._sink, self._now = sink, now
        self._begun: set[int] = set()
        self._renderer: RowRenderer | None = None
        self._is_off = False
        sink.channel(PICTURES_TOPIC, "embodichain.Pictures")

    def restart(self) -> None:
        """Do nothing: messages need none before them."""

    def on_reset(self, env_ids: EnvIndex) -> None:
        """Note that episodes of these environments begin."""
        self._begun.update(env_ids.tolist())

    def on_rows(self, step: int, rows: F64) -> None:
        """Write the hashes of episodes that begin with a control step.

        Args:
            step: The control step.
            rows: (N, nstate) rows before its physics.
        """
        ids, self._begun = sorted(self._begun), set()
        shots = [
            s for camera in self._cameras if camera.was_drawn for s in shots_of(camera).values()
        ]
        if not ids or not shots or self._is_off:
            return
        if self._renderer is None:
            try:
                self._renderer = RowRenderer(self._engine)
                self._renderer.open()
            except RenderError as error:
                self._is_off = True
                _log.warning("the log has no hashes of pictures: %s", error)
                return
        digests = [self._renderer.digests(env_id, rows[env_id], shots) for env_id in ids]
        for i, shot in enumerate(shots):
            message = message_class("Pictures")(
                step=step,
                **asdict(shot),
                renderer=self._renderer.about,
                env_ids=ids,
                sha256=b"".join(of_all[i] for of_all in digests),
            )
            self._sink.send(self._now(), [(PICTURES_TOPIC, message.SerializeToString())])


class _Hashed(NamedTuple):
    """A message of `PICTURES_TOPIC`: digest of each environment's picture."""

    step: int
    shot: Shot
    renderer: str
    digests: dict[int, bytes]


def _recorded(reader: LogReader) -> Iterator[_Hashed]:
    for topic, _, payload in reader.messages():
        if topic == PICTURES_TOPIC:
            try:
                yield _decoded(bytes(payload))
            except DamageError as error:
                raise LogError(f"{reader.path}: a message is damaged: {error}") from error


def _decoded(data: bytes) -> _Hashed:
    try:
        message = message_class("Pictures").FromString(data)
    except DecodeError as error:
        raise DamageError(f"hashes of pictures are damaged: {error}") from error
    size, planes = (message.width, message.height), (message.near, message.far)
    shot = Shot(message.camera, *size, *planes, message.look, tuple(message.outputs))
    sizes = 0 < shot.width <= LARGEST_SIDE and 0 < shot.height <= LARGEST_SIDE
    known = shot.look in _LOOKS and shot.outputs and not set(shot.outputs) - set(_OUTPUTS)
    whole = len(message.sha256) == _DIGEST * len(message.env_ids)
    if not (sizes and known and whole and 0 < shot.near < shot.far < np.inf):
        raise DamageError("hashes of pictures are damaged")
    hashes = (message.sha256[i : i + _DIGEST] for i in range(0, len(message.sha256), _DIGEST))
    digests = dict(zip(message.env_ids, hashes, strict=True))
    return _Hashed(message.step, shot, message.renderer, digests)


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
    hashed: dict[int, list[_Hashed]] = {}
    for one in _recorded(reader):
        hashed.setdefault(one.step, []).append(one)
    if not hashed:
        return 0, ["the log has no hashes of pictures: no camera was read"]
    ids = np.arange(header.num_envs) if env is None else np.array([env])
    active = always(len(ids)) if header.keyframe_every else never(len(ids))
    simulation = Simulation(reader, model, ids, active, num_threads=1)
    renderer = RowRenderer(simulation.engine)
    drawn_by = {one.renderer for found in hashed.values() for one in found} - {renderer.about}
    if drawn_by:
        other = ", ".join(sorted(drawn_by))
        return 0, [f"pictures were drawn by {other}; here by {renderer.about}: not comparable"]
    equal = 0
    for run, t in follow(reader, simulation):
        for one in hashed.pop(run.first + t, ()):
            for local, env_id in enumerate(ids.tolist()):
                if env_id not in one.digests:
                    continue
                found = _digest(renderer, local, simulation, one.shot, reader)
                if found != one.digests[env_id]:
                    where = f"step {one.step}, environment {env_id}, camera {one.shot.camera}"
                    return equal, [f"{where}: the picture differs from the recorded one"]
                equal += 1
    if hashed:
        return equal, [f"the log lacks control step {min(hashed)}, whose pictures it has hashes of"]
    return equal, []


def _digest(
    renderer: RowRenderer, local: int, simulation: Simulation, shot: Shot, reader: LogReader
) -> bytes:
    try:
        (found,) = renderer.digests(local, simulation.rows[local], [shot])
    except ValueError as error:
        raise LogError(f"{reader.path}: a message is damaged: {error}") from error
    return found
