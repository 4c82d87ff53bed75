"""Cameras in the model: what they are fixed on, MuJoCo's cameras for them, and their ids."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.names import (
    FRAME_KINDS,
    FrameKind,
    Jointed,
    Known,
    KnownObject,
    find_frame,
    find_frame_of,
    frame_names,
    no_such,
)
from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex
from embodichain.lab.sim.configs.references import LinksCfg
from embodichain.lab.sim.configs.scene_cfg import DEFAULT_VIEW
from embodichain.lab.sim.sensors.camera_cfg import CameraCfg, StereoCameraCfg, look_points
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    euler_xyz_to_quat,
    look_at,
    matrix_to_quat,
    normalize_quat,
    quat_multiply,
    quat_rotate,
)

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import F64, EntityIndex
    from embodichain.lab.sim.compiler.scene.known import Place

__all__ = [
    "PIXEL",
    "RIGHT",
    "CameraIndex",
    "add_camera",
    "camera_names",
    "default_lens",
    "entity_of_geom",
    "mount",
    "pair_offset",
    "picture_names",
]

RIGHT = "/right"
"""Suffix of the name of a stereo camera's right camera."""
PIXEL = 1e-5
"""Metres between pixels of a declared camera with intrinsics; only ratios to it matter."""
_FROM_ROS = np.array([0.0, 1.0, 0.0, 0.0])
"""Half a turn about x: from ROS's camera axes to OpenGL's."""


@dataclass(frozen=True, eq=False)
class CameraIndex(SensorIndex):
    """A camera sensor in the compiled model; it has no columns.

    Attributes:
        ids: MuJoCo's ids of its cameras: one, or left and right.
        entity_of_geom: (ngeom + 1,) int32 number in masks of each geom; the last is -1.
        pictures: Name of each of its pictures, ``UID`` or ``UID/right``, in the order of `ids`.
        size: Width and height in pixels.
    """

    ids: tuple[int, ...] = ()
    entity_of_geom: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    pictures: tuple[str, ...] = ()
    size: tuple[int, int] = (0, 0)

    def picture_cameras(self) -> dict[str, tuple[int, tuple[int, int]]]:
        """Name of each of its pictures -> id of the camera in the model, and width and height."""
        return {
            name: (camera, self.size) for name, camera in zip(self.pictures, self.ids, strict=True)
        }


def mount(cfg: CameraCfg, known: Known) -> tuple[LinksCfg | None, list[Problem]]:
    """Return what a camera is fixed on, None for the environment, and every mistake.

    Args:
        cfg: The camera.
        known: The entities of the scene.
    """
    parent = cfg.extrinsics.parent
    if cfg.camera is not None or not parent:
        return (cfg.of if cfg.of.uid else None), []
    if cfg.of.uid:
        message = "`of` is given as well: leave one of them out"
        return None, [Problem("extrinsics.parent", message)]
    entities = {
        uid: entity
        for uid, entity in known.items()
        if entity is not None and not isinstance(entity, str)
    }
    uid, slash, rest = parent.partition("/")
    if slash and uid in known:
        entity = entities.get(uid)
        if entity is None:  # a light, or unreadable
            return LinksCfg(uid=uid), []
        frame, problems = find_frame_of(entity, uid, rest, "extrinsics.parent")
        return _frame_cfg(uid, frame), problems

    # A name without its entity: one of them must have it.
    jointed = {
        uid: entity for uid, entity in entities.items() if not isinstance(entity, KnownObject)
    }
    carriers: list[LinksCfg] = []
    for name, jointed_entity in jointed.items():
        frame, _ = find_frame_of(jointed_entity, name, parent)
        carrier = _frame_cfg(name, frame)
        if carrier is not None:
            carriers.append(carrier)
    if len(carriers) == 1:
        return carriers[0], []
    if carriers:
        uids = [carrier.uid for carrier in carriers]
        message = f"several entities have {parent!r}: write UID/NAME, UID one of {uids}"
        return None, [Problem("extrinsics.parent", message)]

    names = {kind: _all_frame_names(jointed, kind) for kind in FRAME_KINDS}
    is_prefix = any(name.startswith(f"{uid}/") for name in itertools.chain(*names.values()))
    if slash and not is_prefix:
        return LinksCfg(uid=uid, link=rest), []  # that there is no such entity is said there
    _, problems = find_frame(parent, lambda kind: names[kind], "extrinsics.parent")
    return None, problems


def _all_frame_names(entities: Mapping[str, Jointed], kind: FrameKind) -> tuple[str, ...]:
    """The names of frames of one kind in all entities."""
    names: list[str] = []
    for uid, entity in entities.items():
        names += frame_names(entity, uid, kind) or ()
    return tuple(names)


def _frame_cfg(uid: str, frame: tuple[FrameKind, str] | None) -> LinksCfg | None:
    """The config of a frame of an entity, if it has it."""
    if frame is None:
        return None
    kind, name = frame
    values: dict[str, Any] = {kind: name}
    return LinksCfg(uid=uid, **values)


def picture_names(uid: str, cfg: CameraCfg) -> dict[str, str]:
    """Name of each picture of a sensor to the camera in the model that it is of.

    Pictures are named after the sensor, since several sensors may use one camera of a file.
    """
    cameras = camera_names(uid, cfg)
    return dict(zip((uid, uid + RIGHT)[: len(cameras)], cameras, strict=True))


def camera_names(uid: str, cfg: CameraCfg) -> tuple[str, ...]:
    """Names of a sensor's cameras in the model: one, or left and right."""
    if isinstance(cfg, StereoCameraCfg):
        return uid, uid + RIGHT
    return (cfg.camera or uid,)


def add_camera(spec: mujoco.MjSpec, uid: str, cfg: CameraCfg, place: Place | None) -> None:
    """Add the cameras of a sensor; one that uses a file's camera only needs to find it.

    Args:
        spec: The scene.
        uid: The sensor's name.
        cfg: Its checked config.
        place: The body that it is fixed on, and the frame there; None is the world.

    Raises:
        ConfigError: If a name is taken, or the file's camera does not exist.
    """
    names = [camera.name for camera in spec.cameras]
    if cfg.camera is not None:
        if cfg.camera not in names:
            raise ConfigError([no_such("camera", cfg.camera, names, f"sensors.{uid}.camera")])
        return
    parent = spec.worldbody
    pos, quat = _pose(cfg)
    if place is not None:
        body, frame_pos, frame_quat = place
        parent = spec.body(body)
        pos = frame_pos + quat_rotate(frame_quat, pos)
        quat = quat_multiply(frame_quat, quat)
    lenses = [cfg.intrinsics]
    if isinstance(cfg, StereoCameraCfg):
        lenses.append(cfg.intrinsics_right or cfg.intrinsics)
    for side, (name, lens) in enumerate(zip(camera_names(uid, cfg), lenses, strict=True)):
        if name in (*names, DEFAULT_VIEW):
            message = f"the scene has a camera {name!r} already: choose another name"
            raise ConfigError([Problem(f"sensors.{uid}", message)])
        camera_pos = pos
        camera_quat = quat
        if isinstance(cfg, StereoCameraCfg):
            offset, turn = pair_offset(cfg, side)
            camera_pos = pos + quat_rotate(quat, offset)
            camera_quat = quat_multiply(quat, turn)
        camera = parent.add_camera(name=name, pos=camera_pos, quat=camera_quat)
        camera.resolution = [cfg.width, cfg.height]
        if cfg.fovy is not None and lens is None:
            camera.fovy = cfg.fovy
            continue
        fx, fy, cx, cy = lens or default_lens(cfg.width, cfg.height)
        camera.sensor_size = [PIXEL * cfg.width, PIXEL * cfg.height]
        camera.focal_pixel = [fx, fy]
        # MuJoCo counts from the middle, to the left and up.
        camera.principal_pixel = [cfg.width / 2 - cx, cfg.height / 2 - cy]


def default_lens(width: int, height: int) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a camera without `fovy` and `intrinsics`; EmbodiChain's at 640x480."""
    return 1.25 * height, 1.25 * height, width / 2, height / 2


def pair_offset(cfg: StereoCameraCfg, side: int) -> tuple[F64, F64]:
    """Pose of the left (0) or right (1) camera in the frame of the point halfway between them."""
    offset = (side - 0.5) * np.asarray(cfg.left_to_right_pos, np.float64)
    turn = euler_xyz_to_quat(np.radians(np.asarray(cfg.left_to_right_rot, np.float64)) * side)
    return offset, turn


def entity_of_geom(model: mujoco.MjModel, entities: Mapping[str, EntityIndex]) -> NDArray[np.int32]:
    """(ngeom + 1,) number in masks of each geom: the root body of its entity, 0 for the world's.

    The last is -1: geom -1 is the background.
    """
    root = np.array(model.body_rootid, np.int32)
    for index in entities.values():
        root[index.body_ids] = index.root_body_id
    return np.append(root[model.geom_bodyid], -1).astype(np.int32)


def _pose(cfg: CameraCfg) -> tuple[F64, F64]:
    """Position and wxyz orientation (OpenGL's axes) in the frame of the body."""
    extrinsics: Any = cfg.extrinsics
    if extrinsics.eye is not None:
        eye, target, up = look_points(extrinsics)
        return eye, matrix_to_quat(look_at(eye, target, up))
    quat = normalize_quat(np.asarray(extrinsics.quat, np.float64))
    if cfg.convention == "ros":
        quat = quat_multiply(quat, _FROM_ROS)
    return np.asarray(extrinsics.pos, np.float64), quat
