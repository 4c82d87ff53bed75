"""Rerun: the scene in 3D, joints, actions, rewards and episodes as curves, events as text.

Entities: ``/world/env_I/UID/LINK``, and below ``/env_I``: ``joint_positions``,
``joint_velocities``, ``actions``, ``reward``, ``metrics`` (of viewed environments),
``episode/return``, ``episode/length``, ``log``, ``camera/NAME`` (pictures as JPEG). The file
contains the layout that shows them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.log_parts import Part, about, poses
from embodichain.recording.film.frames import FilmCamera, Placed, cameras_of, frames
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.playback import Playback, span_of
from embodichain.recording.views.channels import event_text, scalar_joints
from embodichain.recording.views.encoders import jpeg
from embodichain.recording.views.shapes import Shape, corner_normals, mesh_of, shapes

__all__ = ["write_rrd"]

F64 = NDArray[np.float64]
_EYE = np.array([1.0, -1.2, 0.8])
"""Direction from the scene's centre to the viewer's eye."""
_PICTURES_HZ = 25.0
"""Most pictures of a camera in a second of simulated time."""
_STEPS = 1000
"""Number of steps with poses sent together."""
_PALETTE = (
    *(0x4E98E2, 0xF5774D, 0xF7DF71, 0x5CD6A9, 0xA395E2),
    *(0xEA4D6C, 0x61CBFF, 0x9AA5B1, 0xC08552),
)


@log_format("rrd", suffix=".rrd", requires="embodichain[rerun]", pictures=True)
def write_rrd(log: Log, part: Part, path: Path) -> None:
    """Write the selected environment, or the viewed ones.

    Raises:
        ConfigError: If rerun is not installed, or there is no such camera.
        OSError: If the file cannot be written.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    envs, cameras = part.envs_of(log), cameras_of(log, part.cameras, part.size)
    fields = {"qpos", "qvel", "actions", "rewards"}
    names = [name for name in log.columns if name in fields]
    offsets = _offsets(log) if len(envs) > 1 else {}
    places = np.array([offsets.get(env, np.zeros(3)) for env in envs])
    required("rerun", "rrd", package="rerun-sdk")
    paths = {env: _camera_paths(log.model, env, cameras) for env in envs}
    recording = _Recording(log, _layout(log.model, envs, places, paths[envs[0]]))
    recording.log("world", recording.rr.ViewCoordinates.RIGHT_HAND_Z_UP, None)
    for env, place in zip(envs, places, strict=True):
        _Scene(recording, log, env, place).send(part)
        _name_curves(recording, log, env)
    first = last = -1
    for data in log.parts(names, envs, part.episode, part.start, part.stop):
        first = int(data.steps[0]) if first < 0 else first
        last = int(data.steps[-1])
        for column, env in enumerate(envs):
            _send_curves(recording, log, env, data, column)
    for env in envs:
        _send_rest(recording, log, env, first, last)
        if cameras:
            _send_pictures(recording, log, env, part, cameras, paths[env])
    recording.save(path)


def _offsets(log: Log) -> dict[int, F64]:
    """Positions of the environments for viewers, from the first message of `/tf`."""
    for topic, _, payload in log.raw_messages():
        if topic == "/tf":
            message = FrameTransforms.FromString(bytes(payload))
            return {
                int(t.child_frame_id.removeprefix("env_")): np.array(
                    [t.translation.x, t.translation.y, t.translation.z]
                )
                for t in message.transforms
                if t.parent_frame_id == "world"
            }
    return {}


class _Recording:
    """An `.rrd` file with the timelines ``step`` (control steps) and ``sim_time`` (seconds).

    It is in memory until `save`, because rerun's writer hangs if the disk is full.

    Args:
        log: The log.
        blueprint: The initial layout of a viewer.
    """

    def __init__(self, log: Log, blueprint: Any) -> None:
        self.rr: Any = required("rerun", "rrd", package="rerun-sdk")
        header = log.header
        self._dt = header.control_dt
        # The same log gives the same recording id: a viewer replaces it by a second export.
        name = f"{header.task}-{header.seed}-{header.start_ns}"
        made: Any = self.rr.RecordingStream("embodichain", recording_id=name)
        self._bytes: Any = made.binary_stream()
        made.send_blueprint(blueprint, make_active=False)
        made.set_log_time_enabled(False)  # neither belongs to the run
        made.set_log_tick_enabled(False)
        made.send_recording_name(f"{header.task}, seed {header.seed}")
        made.send_recording_start_time_nanos(header.start_ns)
        made.send_property("embodichain", self.rr.AnyValues(**about(log)))
        self._recording = made

    def save(self, path: Path) -> None:
        """Write the file; nothing can be sent afterwards."""
        with path.open("xb") as file:
            file.write(self._bytes.read() or b"")
        self._recording.disconnect()

    def log(self, path: str, archetype: Any, step: int | None) -> None:
        """Send an archetype at a step; None is at all times."""
        if step is not None:
            self._recording.set_time("step", sequence=step)
            self._recording.set_time("sim_time", duration=step * self._dt)
        self._recording.log(path, archetype, static=step is None, strict=True)

    def columns(self, path: str, steps: NDArray[np.int64], columns: Iterable[Any]) -> None:
        """Send columns with a row for each of the steps."""
        times = [
            self.rr.TimeColumn("step", sequence=steps),
            self.rr.TimeColumn("sim_time", duration=steps.astype(np.float64) * self._dt),
        ]
        self._recording.send_columns(path, times, columns, strict=True)

    def name(self, path: str, names: Sequence[str]) -> None:
        """Name the curves at a path."""
        colors = np.resize(np.array(_PALETTE, np.uint32) << 8 | 0xFF, len(names))
        self.log(path, self.rr.SeriesLines(names=names, colors=colors), None)

    def curves(self, path: str, steps: NDArray[np.int64], values: NDArray[Any]) -> None:
        """Send (T, K) numbers: K curves."""
        if values.size:
            flat = self.rr.Scalars.columns(scalars=values.astype(np.float64).reshape(-1))
            self.columns(path, steps, flat.partition(np.full(len(values), values.shape[1])))


def _layout(
    model: mujoco.MjModel, envs: Sequence[int], places: F64, cameras: Mapping[str, str]
) -> Any:
    """Return the layout: the scene, and next to it joints, reward and events.

    Args:
        model: The scene's model.
        envs: The environments that are shown; curves are of the first one.
        places: (n, 3) positions of the environments, metres.
        cameras: Names of the cameras with pictures, to their paths.
    """
    rrb: Any = required("rerun.blueprint", "rrd", package="rerun-sdk")
    center = np.array(model.stat.center, np.float64) + places.mean(axis=0)
    size = float(model.stat.extent) + float(np.linalg.norm(np.ptp(places, axis=0)))
    eye = center + size * _EYE / np.linalg.norm(_EYE)
    controls = rrb.EyeControls3D(position=eye, look_target=center, eye_up=(0, 0, 1))

    def curves(path: str, name: str) -> Any:
        return rrb.TimeSeriesView(origin=f"/env_{envs[0]}/{path}", name=name)

    tabs = rrb.Tabs(
        rrb.TextLogView(origin=f"/env_{envs[0]}/log", name="log"),
        curves("metrics", "metrics"),
        curves("episode", "episodes"),
        curves("actions", "actions"),
    )
    joints = curves("joint_positions", "joint positions (rad, m)")
    right = rrb.Vertical(joints, curves("reward", "reward"), tabs, row_shares=[2, 1, 1])
    left = rrb.Spatial3DView(origin="/world", name="scene", eye_controls=controls)
    if cameras:
        images = [rrb.Spatial2DView(origin=path, name=name) for name, path in cameras.items()]
        left = rrb.Vertical(left, rrb.Horizontal(*images), row_shares=[2, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
    )


# -- curves and lines ------------------------------------------------------------------------------


def _name_curves(recording: _Recording, log: Log, env: int) -> None:
    joints = list(scalar_joints(log.model))
    actions = [column.name for column in log.columns.get("actions", [])]
    for path, names in (
        ("joint_positions", joints),
        ("joint_velocities", joints),
        ("actions", actions),
        ("reward", ["reward"]),
    ):
        recording.name(f"/env_{env}/{path}", names)


def _send_curves(recording: _Recording, log: Log, env: int, data: LogArrays, column: int) -> None:
    """Send some steps of an environment, from one column of the data."""
    model, ids = log.model, list(scalar_joints(log.model).values())
    for field, path, columns in (
        ("qpos", "joint_positions", model.jnt_qposadr[ids]),
        ("qvel", "joint_velocities", model.jnt_dofadr[ids]),
        ("actions", "actions", slice(None)),
    ):
        if field in data.values:
            values = data[field][:, column][:, columns]
            recording.curves(f"/env_{env}/{path}", data.steps, values)
    recording.curves(f"/env_{env}/reward", data.steps, data["rewards"][:, column, None])


def _send_rest(recording: _Recording, log: Log, env: int, first: int, last: int) -> None:
    """Send sampled metrics, episodes that ended, and events."""
    root = f"/env_{env}"
    if env in log.header.view_envs:
        steps, values = log.metrics(env)
        chosen = (steps >= first) & (steps <= last)
        names = [name for name in values if name not in ("reward", "terminated", "truncated")]
        if names and chosen.any():
            recording.name(f"{root}/metrics", names)
            table = np.stack([values[name][chosen] for name in names], axis=1)
            recording.curves(f"{root}/metrics", steps[chosen], table)
    ended = [e for e in log.episodes if e.env == env and (e.terminated or e.truncated)]
    ended = [e for e in ended if first <= e.last_step <= last]
    at = np.array([e.last_step for e in ended], np.int64)
    for name, numbers in (
        ("return", [e.total_reward for e in ended]),
        ("length", [e.steps for e in ended]),
    ):
        recording.curves(f"{root}/episode/{name}", at, np.array(numbers)[:, None])
    lines = []
    for event in log.events():
        if first <= event.step <= last and (event.env_ids is None or env in event.env_ids):
            row = env if event.env_ids is None else int(np.flatnonzero(event.env_ids == env)[0])
            drawn = {name: values[row] for name, values in event.drawn.items()}
            lines.append((event.step, event_text(env, event.term, event.mode, drawn)))
    for e in ended:
        how = "terminated" if e.terminated else "truncated"
        ending = f"{how} after {e.steps} steps, return {e.total_reward:.4g}"
        lines.append((e.last_step, f"environment {env}: episode {e.episode} {ending}"))
    if lines:
        at_steps, texts = zip(*sorted(lines, key=lambda line: line[0]), strict=True)
        columns = recording.rr.TextLog.columns(text=texts, level=["INFO"] * len(texts))
        recording.columns(f"{root}/log", np.array(at_steps, np.int64), columns)


def _send_pictures(
    recording: _Recording,
    log: Log,
    env: int,
    part: Part,
    cameras: Mapping[str, FilmCamera],
    paths: Mapping[str, str],
) -> None:
    """Send the pictures of an environment, at most `_PICTURES_HZ` a second."""
    span = span_of(log, env, part.episode, part.start, part.last)
    every = max(1, math.ceil(1.0 / (_PICTURES_HZ * log.dt) - 1e-9))
    with closing(OffscreenRenderer(log.model)) as renderer:
        drawn = frames(renderer, Playback(log, env), list(cameras.values()), span, every)
        for frame in drawn:
            for name, picture, placed in zip(cameras, frame.pictures, frame.cameras, strict=True):
                path = paths[name]
                for archetype in _pinhole(recording.rr, picture.shape, placed):
                    recording.log(path, archetype, frame.step)
                image = recording.rr.EncodedImage(contents=jpeg(picture), media_type="image/jpeg")
                recording.log(path, image, frame.step)


def _camera_paths(model: mujoco.MjModel, env: int, names: Iterable[str]) -> dict[str, str]:
    r"""Path of each camera, below the scene, so that Rerun shows its frustum and picture there.

    Rerun multiplies poses along a path, and has no lens below a lens: a camera is below nothing
    that has either, so a name is one part of the path (``twins\/right``), and the part before it
    is no body's.
    """
    rr: Any = required("rerun", "rrd", package="rerun-sdk")
    bodies = {model.body(i).name.partition("/")[0] for i in range(model.nbody)}
    group = "camera"
    while group in bodies:
        group += "_"
    root = f"/world/env_{env}/{group}"
    return {name: f"{root}/{rr.escape_entity_path_part(name)}" for name in names}


def _pinhole(rr: Any, shape: tuple[int, ...], placed: Placed) -> tuple[Any, Any]:
    """Pose and lens of a camera; its x axis points right and its y axis up, as in OpenGL."""
    height, width = shape[:2]
    fx, fy, cx, cy = placed.lens.tolist()
    pose = rr.Transform3D(translation=placed.position, mat3x3=placed.axes)
    lens = rr.Pinhole(
        image_from_camera=[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        resolution=[width, height],
        camera_xyz=rr.ViewCoordinates.RUB,
    )
    return pose, lens


# -- the scene -------------------------------------------------------------------------------------


class _Scene:
    """One environment in 3D: shapes below the path of their body, and the body's pose over time.

    The pose of each body is relative to the environment, as in `/tf`.

    Args:
        recording: The recording to send to.
        log: The log.
        env_id: The environment.
        offset: (3,) position of the environment in the world, metres.
    """

    def __init__(self, recording: _Recording, log: Log, env_id: int, offset: F64) -> None:
        self._recording, self._log, self._env_id = recording, log, env_id
        root = f"/world/env_{env_id}"
        self._paths = _paths(recording.rr, log.model, root)
        self._drawn: dict[str, tuple[Any, ...]] = {}  # path to the arrays drawn there
        self._last: F64 | None = None
        recording.log(root, recording.rr.Transform3D(translation=offset), None)

    def send(self, part: Part) -> None:
        """Send the control steps of a part."""
        steps, rows = list[int](), list[F64]()
        for step, data, changed in poses(self._log, self._env_id, part):
            steps.append(step)
            rows.append(np.concatenate([data.xpos[1:], data.xquat[1:]], axis=1))
            if changed:
                self._draw(data.model, step)
            if len(steps) == _STEPS:
                self._move(steps, rows)
                steps, rows = [], []
        if steps:
            self._move(steps, rows)

    def _draw(self, model: mujoco.MjModel, step: int) -> None:
        """Draw new or changed shapes: primitives by body and kind, and each mesh."""
        groups: dict[tuple[int, str], list[Shape]] = {}
        for shape in shapes(model):
            name = f"mesh_{shape.geom}" if shape.kind == "mesh" else shape.kind
            groups.setdefault((shape.body, name), []).append(shape)
        for (body, name), group in groups.items():
            path, is_mesh = f"{self._paths[body]}/{name}", group[0].kind == "mesh"
            look = _mesh(model, group[0]) if is_mesh else _primitives(group)
            before = self._drawn.get(path)
            if before is None or not all(map(np.array_equal, before, look)):
                self._drawn[path] = look
                made = _archetype(self._recording.rr, group[0].kind, look)
                self._recording.log(path, made, step)

    def _move(self, numbers: list[int], rows: list[F64]) -> None:
        """Send (nbody - 1, 7) poses of some steps; for each body only those that changed."""
        steps, poses = np.array(numbers, np.int64), np.array(rows)
        first = poses[:1] if self._last is None else self._last
        changed = np.any(np.diff(poses, axis=0, prepend=first) != 0, axis=2)
        changed[0] |= self._last is None
        self._last = poses[-1:]
        for body, path in enumerate(self._paths[1:]):
            there = changed[:, body]
            if there.any():
                here = poses[there, body]
                columns = self._recording.rr.Transform3D.columns(
                    translation=here[:, :3], quaternion=here[:, [4, 5, 6, 3]]
                )
                self._recording.columns(path, steps[there], columns)


def _paths(rr: Any, model: mujoco.MjModel, root: str) -> list[str]:
    """Paths of bodies by id. They are not nested, because nested poses would be multiplied."""
    names = [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
    parts = [[rr.escape_entity_path_part(p) for p in name.split("/") if p] for name in names]
    paths = ["/".join([root, *part]) for part in parts]
    inner = {p for p in paths if any(other.startswith(f"{p}/") for other in paths)}
    return [f"{root}/world", *(f"{p}/body" if p in inner else p for p in paths)]


def _primitives(group: list[Shape]) -> tuple[Any, ...]:
    pos, quat, half, rgba = (
        np.array([getattr(shape, name) for shape in group])
        for name in ("pos", "quat", "half", "rgba")
    )
    if group[0].kind == "capsule":  # in Rerun, its origin is the centre of one cap
        for center, turn, (_, _, z) in zip(pos, quat, half, strict=True):
            axis = np.empty(3)
            mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, z]), turn)
            center -= axis
    return pos, quat[:, [1, 2, 3, 0]], half, _packed(rgba)


def _mesh(model: mujoco.MjModel, shape: Shape) -> tuple[Any, ...]:
    """Vertices, faces and normals in the body's frame, and the colour; corners are not shared."""
    mesh = mesh_of(model, shape.geom)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, shape.quat)
    matrix = turn.reshape(3, 3).T
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3) @ matrix + shape.pos
    normals = corner_normals(mesh) @ matrix
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    return vertices.astype(np.float32), faces, normals.astype(np.float32), _packed(shape.rgba)


def _archetype(rr: Any, kind: str, look: tuple[Any, ...]) -> Any:
    if kind == "mesh":
        vertices, faces, normals, rgba = look
        arrays = {"vertex_positions": vertices, "triangle_indices": faces}
        return rr.Mesh3D(**arrays, vertex_normals=normals, albedo_factor=int(rgba))
    pos, quat, half, rgba = look
    common = {"quaternions": quat, "colors": rgba, "fill_mode": "solid"}
    if kind == "box":
        return rr.Boxes3D(half_sizes=half, centers=pos, **common)
    if kind == "ellipsoid":
        return rr.Ellipsoids3D(half_sizes=half, centers=pos, **common)
    lengths, radii = 2 * half[:, 2], half[:, 0]
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=lengths, radii=radii, centers=pos, **common)
    return rr.Capsules3D(lengths=lengths, radii=radii, translations=pos, **common)


def _packed(rgba: F64) -> NDArray[np.uint32]:
    """(..., 4) in 0 to 1 as 0xRRGGBBAA, since four numbers could mean four colours."""
    levels = np.clip(np.rint(255 * rgba), 0, 255).astype(np.uint32)
    shifted = levels << np.array([24, 16, 8, 0], np.uint32)
    packed: NDArray[np.uint32] = np.bitwise_or.reduce(shifted, axis=-1)
    return packed
