"""Rerun: the scene in 3D, joints, actions, rewards and episodes as curves, events as text.

Entities: ``/world/env_I/UID/LINK``, and below ``/env_I``: ``joint_positions``,
``joint_velocities``, ``actions``, ``reward``, ``metrics`` (of viewed environments),
``episode/return``, ``episode/length``, ``drawn/TERM.NAME`` (at the first step of an episode),
``log``, ``camera/NAME`` (pictures as JPEG). The file contains the layout that shows them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.log_parts import Part, about, poses, span_of_part
from embodichain.recording.film.frames import FilmCamera, Placed, cameras_of, frames
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import Playback
from embodichain.recording.views.channels import event_text, scalar_joints
from embodichain.recording.views.encoders import jpeg
from embodichain.recording.views.shapes import Shape, corner_normals, mesh_of, shapes
from embodichain.utils.number_text import result_number

__all__ = ["write_rrd"]

F64 = NDArray[np.float64]
_EYE = np.array([1.0, -1.2, 0.8])
"""Direction from the scene's centre to the viewer's eye."""
_PICTURES_HZ = 25.0
"""Most pictures of a camera in a second of simulated time."""
_STEPS = 1000
"""Number of steps with poses sent together."""
_PALETTE = (
    0x4E98E2,
    0xF5774D,
    0xF7DF71,
    0x5CD6A9,
    0xA395E2,
    0xEA4D6C,
    0x61CBFF,
    0x9AA5B1,
    0xC08552,
)
"""Colours of curves, 0xRRGGBB."""
_CURVES_OF_FIELDS = {
    "qpos": "joint_positions",
    "qvel": "joint_velocities",
    "actions": "actions",
}
"""Field of a log to the path of its curves."""


@log_format("rrd", suffix=".rrd", requires="embodichain[rerun]", pictures=True)
def write_rrd(log: Log, part: Part, path: Path) -> None:
    """Write the selected environment, or the viewed ones.

    Raises:
        ConfigError: If rerun is not installed, or there is no such camera.
        OSError: If the file cannot be written.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    envs = part.envs_of(log)
    cameras = cameras_of(log, part.cameras, part.size)
    fields = {*_CURVES_OF_FIELDS, "rewards"}
    names = [name for name in log.columns if name in fields]
    # An environment alone is at the origin.
    offsets = _offsets(log) if len(envs) > 1 else {}
    positions = np.array([offsets.get(env, np.zeros(3)) for env in envs])
    required("rerun", "rrd", package="rerun-sdk")
    camera_paths = {env: _camera_paths(log.model, env, cameras) for env in envs}
    recording = _Recording(log, _layout(log.model, envs, positions, camera_paths[envs[0]]))
    recording.log("world", recording.rr.ViewCoordinates.RIGHT_HAND_Z_UP, None)
    for env, position in zip(envs, positions, strict=True):
        _Scene(recording, log, env, position).send(part)
        _name_curves(recording, log, env)
    first_step = -1
    last_step = -1
    parts = log.parts(names, env=envs, episode=part.episode, start=part.start, stop=part.stop)
    for data in parts:
        if first_step < 0:
            first_step = int(data.steps[0])
        last_step = int(data.steps[-1])
        for column, env in enumerate(envs):
            _send_curves(recording, log, env, data, column)
    steps = range(first_step, last_step + 1)
    for env in envs:
        _send_metrics(recording, log, env, steps)
        _send_episodes_and_events(recording, log, env, steps)
        if cameras:
            film = zip(camera_paths[env].values(), cameras.values(), strict=True)
            _send_pictures(recording, log, env, part, dict(film))
    recording.save(path)


def _offsets(log: Log) -> dict[int, F64]:
    """Positions of the environments for viewers, from the first message of `/tf`."""
    for topic, _, payload in log.raw_messages():
        if topic != "/tf":
            continue
        offsets = {}
        for transform in FrameTransforms.FromString(bytes(payload)).transforms:
            if transform.parent_frame_id == "world":
                env = int(transform.child_frame_id.removeprefix("env_"))
                xyz = transform.translation
                offsets[env] = np.array([xyz.x, xyz.y, xyz.z])
        return offsets
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
        stream: Any = self.rr.RecordingStream("embodichain", recording_id=name)
        self._bytes: Any = stream.binary_stream()
        stream.send_blueprint(blueprint, make_active=False)
        # Time and count of these calls do not belong to the run.
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        stream.send_recording_name(f"{header.task}, seed {header.seed}")
        stream.send_recording_start_time_nanos(header.start_ns)
        stream.send_property("embodichain", self.rr.AnyValues(**about(log)))
        self._stream = stream

    def save(self, path: Path) -> None:
        """Write the file; nothing can be sent afterwards."""
        with path.open("xb") as file:
            file.write(self._bytes.read() or b"")
        self._stream.disconnect()

    def log(self, path: str, archetype: Any, step: int | None) -> None:
        """Send an archetype at a step; None is at all times."""
        if step is not None:
            self._stream.set_time("step", sequence=step)
            self._stream.set_time("sim_time", duration=step * self._dt)
        self._stream.log(path, archetype, static=step is None, strict=True)

    def columns(self, path: str, steps: NDArray[np.int64], columns: Iterable[Any]) -> None:
        """Send columns with a row for each of the steps."""
        times = [
            self.rr.TimeColumn("step", sequence=steps),
            self.rr.TimeColumn("sim_time", duration=steps.astype(np.float64) * self._dt),
        ]
        self._stream.send_columns(path, times, columns, strict=True)

    def name(self, path: str, names: Sequence[str]) -> None:
        """Name the curves at a path."""
        colors = np.resize(np.array(_PALETTE, np.uint32) << 8 | 0xFF, len(names))
        self.log(path, self.rr.SeriesLines(names=names, colors=colors), None)

    def curves(self, path: str, steps: NDArray[np.int64], values: NDArray[Any]) -> None:
        """Send (T, K) numbers: K curves."""
        if values.size:
            flat = self.rr.Scalars.columns(scalars=values.astype(np.float64).reshape(-1))
            numbers_by_step = np.full(len(values), values.shape[1])
            self.columns(path, steps, flat.partition(numbers_by_step))


def _layout(
    model: mujoco.MjModel, envs: Sequence[int], positions: F64, camera_paths: Mapping[str, str]
) -> Any:
    """Return the layout: the scene, and next to it joints, reward and events.

    Args:
        model: The scene's model.
        envs: The environments that are shown; curves are of the first one.
        positions: (n, 3) positions of the environments, metres.
        camera_paths: Names of the cameras with pictures, to their paths.
    """
    rrb: Any = required("rerun.blueprint", "rrd", package="rerun-sdk")
    center = np.array(model.stat.center, np.float64) + positions.mean(axis=0)
    size = float(model.stat.extent) + float(np.linalg.norm(np.ptp(positions, axis=0)))
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
    if camera_paths:
        images = [rrb.Spatial2DView(origin=path, name=name) for name, path in camera_paths.items()]
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
    recording.name(f"/env_{env}/joint_positions", joints)
    recording.name(f"/env_{env}/joint_velocities", joints)
    recording.name(f"/env_{env}/actions", actions)
    recording.name(f"/env_{env}/reward", ["reward"])


def _send_curves(recording: _Recording, log: Log, env: int, data: LogArrays, column: int) -> None:
    """Send some steps of an environment, from one column of the data."""
    joints = list(scalar_joints(log.model).values())
    # Coordinates of floating bodies are not curves.
    scalar_columns = {
        "qpos": log.model.jnt_qposadr[joints],
        "qvel": log.model.jnt_dofadr[joints],
    }
    for field, path in _CURVES_OF_FIELDS.items():
        if field in data.values:
            values = data[field][:, column]
            if field in scalar_columns:
                values = values[:, scalar_columns[field]]
            recording.curves(f"/env_{env}/{path}", data.steps, values)
    recording.curves(f"/env_{env}/reward", data.steps, data["rewards"][:, column, None])


def _send_metrics(recording: _Recording, log: Log, env: int, steps: range) -> None:
    """Send the metrics of some steps; only those of viewed environments are in a log."""
    if env not in log.header.view_envs:
        return
    path = f"/env_{env}/metrics"
    sampled_steps, values = log.metrics(env)
    in_range = (sampled_steps >= steps.start) & (sampled_steps < steps.stop)
    names = [name for name in values if name not in ("reward", "terminated", "truncated")]
    if names and in_range.any():
        recording.name(path, names)
        table = np.stack([values[name][in_range] for name in names], axis=1)
        recording.curves(path, sampled_steps[in_range], table)


class _Line(NamedTuple):
    """A line of the text log.

    Attributes:
        step: Its control step.
        text: The line.
    """

    step: int
    text: str


def _send_episodes_and_events(recording: _Recording, log: Log, env: int, steps: range) -> None:
    """Send return and length of episodes that ended in some steps, and lines about all events."""
    root = f"/env_{env}"
    ended = [
        episode
        for episode in log.episodes
        if episode.env == env
        and (episode.terminated or episode.truncated)
        and episode.last_step in steps
    ]
    last_steps = np.array([episode.last_step for episode in ended], np.int64)
    returns = np.array([episode.total_reward for episode in ended])
    lengths = np.array([episode.steps for episode in ended])
    recording.curves(f"{root}/episode/return", last_steps, returns[:, None])
    recording.curves(f"{root}/episode/length", last_steps, lengths[:, None])
    _send_draws(recording, f"{root}/drawn", ended)

    lines = [*_event_lines(log, env, steps), *map(_ending_line, ended)]
    if lines:
        lines.sort(key=lambda line: line.step)  # events before an ending of the same step
        texts = [line.text for line in lines]
        line_steps = np.array([line.step for line in lines], np.int64)
        columns = recording.rr.TextLog.columns(text=texts, level=["INFO"] * len(texts))
        recording.columns(f"{root}/log", line_steps, columns)


def _send_draws(recording: _Recording, root: str, ended: Sequence[LogEpisode]) -> None:
    """Send what was drawn for episodes, each draw as curves with a point at their first steps."""
    episodes: dict[tuple[str, int], list[LogEpisode]] = {}  # by the draw and its width
    for episode in ended:
        for name, numbers in episode.drawn.items():
            episodes.setdefault((name, len(numbers)), []).append(episode)
    for (name, _), of_draw in episodes.items():
        path = f"{root}/{recording.rr.escape_entity_path_part(name)}"
        first_steps = np.array([episode.first_step for episode in of_draw], np.int64)
        values = np.array([episode.drawn[name] for episode in of_draw])
        recording.curves(path, first_steps, values)


def _event_lines(log: Log, env: int, steps: range) -> Iterator[_Line]:
    """Yield a line for each event of an environment in some steps."""
    for event in log.events():
        if event.step not in steps:
            continue
        if event.env_ids is None:  # all environments
            row = env
        elif env in event.env_ids:
            row = int(np.flatnonzero(event.env_ids == env)[0])
        else:
            continue
        drawn = {name: values[row] for name, values in event.drawn.items()}
        yield _Line(event.step, event_text(env, event.term, event.mode, drawn))


def _ending_line(episode: LogEpisode) -> _Line:
    """The line about an episode that ended."""
    ending = "terminated" if episode.terminated else "truncated"
    return _Line(
        episode.last_step,
        f"environment {episode.env}: episode {episode.episode} {ending} after {episode.steps} "
        f"steps, return {result_number(episode.total_reward)}",
    )


def _send_pictures(
    recording: _Recording, log: Log, env: int, part: Part, cameras: Mapping[str, FilmCamera]
) -> None:
    """Send the pictures of an environment, at most `_PICTURES_HZ` a second.

    Args:
        recording: The recording to send to.
        log: The log.
        env: The environment.
        part: The control steps.
        cameras: The path of each camera, and the camera.
    """
    span = span_of_part(log, env, part)
    # 1e-9: a step of exactly the period of a picture is not skipped for its rounding.
    every = max(1, math.ceil(1.0 / (_PICTURES_HZ * log.dt) - 1e-9))
    with closing(OffscreenRenderer(log.model)) as renderer:
        drawn = frames(renderer, Playback(log, env), list(cameras.values()), span, every)
        for frame in drawn:
            for path, picture, placed in zip(cameras, frame.pictures, frame.cameras, strict=True):
                pose, lens = _pinhole(recording.rr, picture.shape, placed)
                image = recording.rr.EncodedImage(contents=jpeg(picture), media_type="image/jpeg")
                recording.log(path, pose, frame.step)
                recording.log(path, lens, frame.step)
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
        self._recording = recording
        self._log = log
        self._env_id = env_id
        root = f"/world/env_{env_id}"
        self._paths = _paths(recording.rr, log.model, root)
        self._drawn: dict[str, tuple[Any, ...]] = {}  # path to the arrays drawn there
        self._last_poses: F64 | None = None
        recording.log(root, recording.rr.Transform3D(translation=offset), None)

    def send(self, part: Part) -> None:
        """Send the control steps of a part."""
        steps: list[int] = []
        rows: list[F64] = []
        for step, data, changed in poses(self._log, self._env_id, part):
            steps.append(step)
            rows.append(np.concatenate([data.xpos[1:], data.xquat[1:]], axis=1))
            if changed:
                self._draw(data.model, step)
            if len(steps) == _STEPS:
                self._send_poses(steps, rows)
                steps = []
                rows = []
        if steps:
            self._send_poses(steps, rows)

    def _draw(self, model: mujoco.MjModel, step: int) -> None:
        """Draw new or changed shapes: primitives by body and kind, and each mesh."""
        groups: dict[tuple[int, str], list[Shape]] = {}
        for shape in shapes(model):
            name = f"mesh_{shape.geom}" if shape.kind == "mesh" else shape.kind
            groups.setdefault((shape.body, name), []).append(shape)
        for (body, name), group in groups.items():
            path = f"{self._paths[body]}/{name}"
            kind = group[0].kind
            arrays = _mesh(model, group[0]) if kind == "mesh" else _primitives(group)
            drawn = self._drawn.get(path)
            if drawn is None or not all(map(np.array_equal, drawn, arrays)):
                self._drawn[path] = arrays
                archetype = _archetype(self._recording.rr, kind, arrays)
                self._recording.log(path, archetype, step)

    def _send_poses(self, step_list: list[int], rows: list[F64]) -> None:
        """Send (nbody - 1, 7) poses of some steps; for each body only those that changed."""
        steps = np.array(step_list, np.int64)
        poses = np.array(rows)
        is_first = self._last_poses is None
        before = poses[:1] if self._last_poses is None else self._last_poses
        has_moved = np.any(np.diff(poses, axis=0, prepend=before) != 0, axis=2)
        has_moved[0] |= is_first
        self._last_poses = poses[-1:]
        for body, path in enumerate(self._paths[1:]):
            moved = has_moved[:, body]
            if moved.any():
                new_poses = poses[moved, body]
                columns = self._recording.rr.Transform3D.columns(
                    translation=new_poses[:, :3],
                    quaternion=new_poses[:, [4, 5, 6, 3]],  # wxyz to xyzw
                )
                self._recording.columns(path, steps[moved], columns)


def _paths(rr: Any, model: mujoco.MjModel, root: str) -> list[str]:
    """Paths of bodies by id. They are not nested, because nested poses would be multiplied."""
    names = [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
    paths = []
    for name in names:
        parts = [rr.escape_entity_path_part(part) for part in name.split("/") if part]
        paths.append("/".join([root, *parts]))
    body_paths = [f"{root}/world"]
    for path in paths:
        is_above_another = any(other.startswith(f"{path}/") for other in paths)
        body_paths.append(f"{path}/body" if is_above_another else path)
    return body_paths


def _primitives(group: list[Shape]) -> tuple[Any, ...]:
    """Centres, rotations (xyzw), half sizes and colours of shapes of one kind."""
    pos = np.array([shape.pos for shape in group])
    quat = np.array([shape.quat for shape in group])
    half = np.array([shape.half for shape in group])
    rgba = np.array([shape.rgba for shape in group])
    if group[0].kind == "capsule":  # in Rerun, its origin is the centre of one cap
        for center, turn, (_, _, half_length) in zip(pos, quat, half, strict=True):
            axis = np.empty(3)
            mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, half_length]), turn)
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


def _archetype(rr: Any, kind: str, arrays: tuple[Any, ...]) -> Any:
    """Return Rerun's object for the arrays of `_mesh` or `_primitives`."""
    if kind == "mesh":
        vertices, faces, normals, rgba = arrays
        return rr.Mesh3D(
            vertex_positions=vertices,
            triangle_indices=faces,
            vertex_normals=normals,
            albedo_factor=int(rgba),
        )
    pos, quat, half, rgba = arrays
    common = {"quaternions": quat, "colors": rgba, "fill_mode": "solid"}
    if kind == "box":
        return rr.Boxes3D(half_sizes=half, centers=pos, **common)
    if kind == "ellipsoid":
        return rr.Ellipsoids3D(half_sizes=half, centers=pos, **common)
    lengths = 2 * half[:, 2]
    radii = half[:, 0]
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=lengths, radii=radii, centers=pos, **common)
    return rr.Capsules3D(lengths=lengths, radii=radii, translations=pos, **common)


def _packed(rgba: F64) -> NDArray[np.uint32]:
    """(..., 4) in 0 to 1 as 0xRRGGBBAA, since four numbers could mean four colours."""
    levels = np.clip(np.rint(255 * rgba), 0, 255).astype(np.uint32)
    shifted = levels << np.array([24, 16, 8, 0], np.uint32)
    return np.bitwise_or.reduce(shifted, axis=-1)
