"""Camera sensors of a scene: checks of their configs, MuJoCo's cameras for them, and their ids."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    frame_names,
    no_such,
)
from embodichain.lab.sim.compiler.sensing.views import DEFAULT_VIEW
from embodichain.lab.sim.configs.sensor_cfg import (
    CAMERA_IMAGES,
    CameraCfg,
    ExtrinsicsCfg,
    LinksCfg,
    StereoCameraCfg,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    euler_xyz_to_quat,
    look_at,
    matrix_to_quat,
    normalize_quat,
    quat_multiply,
    quat_rotate,
)
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.system import platforms

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import F64, EntityIndex
    from embodichain.lab.sim.compiler.scene.known import Place

__all__ = [
    "PIXEL",
    "RIGHT",
    "add_camera",
    "camera_names",
    "check_camera",
    "check_memory",
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
_LARGEST = 16384
"""Pixels; the largest texture of common OpenGL drivers."""
_FROM_ROS = np.array([0.0, 1.0, 0.0, 0.0])
"""Half a turn about x: from ROS's camera axes to OpenGL's."""
_BYTES = {"color": 4, "normal": 12, "position": 12}
"""Bytes of a pixel of an image; 4 for the others."""


# -- checks ----------------------------------------------------------------------------------------


def check_camera(cfg: CameraCfg) -> list[Problem]:
    """Return the mistakes in a camera's config that it alone shows, with paths below it."""
    problems = _check_lens(cfg)
    for key in ("width", "height"):
        pixels = getattr(cfg, key)
        if not 1 <= pixels <= _LARGEST:
            message = f"must be within 1 and {_LARGEST} pixels, got {pixels}"
            problems.append(Problem(key, message))
    if not 0 < cfg.near < np.inf:
        problems.append(Problem("near", f"must be positive, metres, got {cfg.near}"))
    elif cfg.far == np.inf:
        problems.append(Problem("far", "must be finite, metres, got inf"))
    elif not cfg.near < cfg.far:
        problems.append(Problem("far", f"must be greater than near, {cfg.near} m, got {cfg.far}"))
    stereo = isinstance(cfg, StereoCameraCfg)
    unknown = [name for name in cfg.data_types or () if name not in CAMERA_IMAGES]
    for name in unknown:  # a config made in Python is not checked by its types
        message = f"no image {name!r}; allowed: {', '.join(CAMERA_IMAGES)}."
        problems.append(Problem("data_types", message + did_you_mean(name, CAMERA_IMAGES)))
    if not stereo and "disparity" in (cfg.data_types or ()):
        problems.append(Problem("data_types", "disparity is an image of a stereo_camera"))
    elif not unknown and not cfg.get_data_types():
        problems.append(Problem("data_types", "names no image; leave it out for [color]"))
    if isinstance(cfg, StereoCameraCfg):
        offset = np.asarray(cfg.left_to_right_pos, np.float64)
        if not np.isfinite(offset).all() or not offset.any():
            message = f"must be finite and not zero, metres, got {offset.tolist()}"
            problems.append(Problem("left_to_right_pos", message))
    named = cfg.of != LinksCfg(preserve_order=cfg.of.preserve_order)
    if named and not cfg.of.uid:
        message = "missing: the entity that has the links, sites or geoms"
        problems.append(Problem("of.uid", message))
    if cfg.camera is None:
        return problems + _check_extrinsics(cfg.extrinsics)
    if stereo:
        problems.append(Problem("camera", "a stereo_camera has two cameras: leave it out"))
    own = {"fovy": cfg.fovy, "intrinsics": cfg.intrinsics, "of": cfg.of.uid}
    own["extrinsics"] = cfg.extrinsics != ExtrinsicsCfg()
    message = HAS_ITS_OWN.format(cfg.camera)
    return problems + [Problem(key, message) for key, given in own.items() if given]


HAS_ITS_OWN = "camera {!r} has its own: leave it out"
SAID_BY_EYE = "eye and target are given as well: leave one of them out"


def _check_lens(cfg: CameraCfg) -> list[Problem]:
    problems: list[Problem] = []
    if cfg.fovy is not None and cfg.intrinsics is not None:
        problems.append(Problem("intrinsics", "fovy is given as well: leave one of them out"))
    if cfg.fovy is not None and not 0 < cfg.fovy < 180:
        message = f"must be greater than 0 and less than 180 degrees, got {cfg.fovy}"
        problems.append(Problem("fovy", message))
    for key in ("intrinsics", "intrinsics_right"):
        given = getattr(cfg, key, None)
        if given is None:
            continue
        values = np.asarray(given, np.float64)
        if values.shape != (4,) or not np.isfinite(values).all() or (values[:2] <= 0).any():
            message = f"fx, fy, cx, cy in pixels, finite, fx and fy positive; got {list(given)}"
            problems.append(Problem(key, message))
    return problems


def _check_extrinsics(cfg: ExtrinsicsCfg) -> list[Problem]:
    problems: list[Problem] = []
    for key in ("pos", "quat", "eye", "target", "up"):
        value = getattr(cfg, key)
        if value is not None and not np.isfinite(np.asarray(value, np.float64)).all():
            problems.append(Problem(f"extrinsics.{key}", f"must be finite, got {value}"))
    if not np.asarray(cfg.quat, np.float64).any():
        problems.append(Problem("extrinsics.quat", "must not be zero: it is a rotation, wxyz"))
    if cfg.eye is None and cfg.target is None:
        if cfg.up is not None:
            problems.append(Problem("extrinsics.up", "belongs to eye and target"))
        return problems
    for key, other in (("eye", "target"), ("target", "eye")):
        if getattr(cfg, key) is None:
            message = f"missing: {other} is given, and the pose needs both"
            problems.append(Problem(f"extrinsics.{key}", message))
    default = ExtrinsicsCfg()
    for key in ("pos", "quat"):
        if list(getattr(cfg, key)) != list(getattr(default, key)):
            problems.append(Problem(f"extrinsics.{key}", SAID_BY_EYE))
    if not problems:
        try:
            look_at(*_points(cfg))
        except ValueError as error:
            problems.append(Problem("extrinsics.target", str(error)))
    return problems


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
        message = "of is given as well: leave one of them out"
        return None, [Problem("extrinsics.parent", message)]
    entities = {u: e for u, e in known.items() if e is not None and not isinstance(e, str)}
    uid, slash, rest = parent.partition("/")
    if slash and uid in known:
        entity = entities.get(uid)
        if entity is None:  # a light, or unreadable
            return LinksCfg(uid=uid), []
        return _mounted(uid, *find_frame(rest, _names_of(uid, entity), "extrinsics.parent"))
    jointed = {u: e for u, e in entities.items() if not isinstance(e, KnownObject)}
    found = [_mounted(u, *find_frame(parent, _names_of(u, e), "")) for u, e in jointed.items()]
    there = [where for where, _ in found if where is not None]
    if len(there) == 1:
        return there[0], []
    if there:
        uids = [where.uid for where in there]
        message = f"several entities have {parent!r}: write UID/NAME, UID one of {uids}"
        return None, [Problem("extrinsics.parent", message)]
    names = {
        kind: tuple(n for u, e in jointed.items() for n in frame_names(e, u, kind) or ())
        for kind in FRAME_KINDS
    }
    if slash and not any(name.startswith(f"{uid}/") for own in names.values() for name in own):
        return LinksCfg(uid=uid, link=rest), []  # that there is no such entity is said there
    return None, find_frame(parent, lambda kind: names[kind], "extrinsics.parent")[1]


def _names_of(
    uid: str,
    entity: Jointed | KnownObject,
) -> Callable[[FrameKind], tuple[str, ...] | None]:
    return lambda kind: frame_names(entity, uid, kind)


def _mounted(
    uid: str, frame: tuple[FrameKind, str] | None, problems: list[Problem]
) -> tuple[LinksCfg | None, list[Problem]]:
    """The config of the frame that was found."""
    if frame is None:
        return None, problems
    kind, name = frame
    given: dict[str, Any] = {kind: name}
    return LinksCfg(uid=uid, **given), problems


def check_memory(cfg: CameraCfg, num_envs: int) -> list[Problem]:
    """Return a problem if a camera's images of all N environments exceed the memory."""
    limit = platforms.memory_bytes()
    images = cfg.get_data_types()
    each = sum(_BYTES.get(name.removesuffix("_right"), 4) for name in images)
    needed = each * cfg.width * cfg.height * num_envs
    if needed <= limit:
        return []
    message = (
        f"{num_envs} environments x {cfg.width} x {cfg.height} pixels of "
        f"{', '.join(images)} need {needed / 2**30:.1f} GiB; there are {limit / 2**30:.1f}"
    )
    return [Problem("width", message)]


# -- the model -------------------------------------------------------------------------------------


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
    parent, (pos, quat) = spec.worldbody, _pose(cfg)
    if place is not None:
        body, at, turned = place
        parent = spec.body(body)
        pos, quat = at + quat_rotate(turned, pos), quat_multiply(turned, quat)
    lenses = [cfg.intrinsics]
    if isinstance(cfg, StereoCameraCfg):
        lenses.append(cfg.intrinsics_right or cfg.intrinsics)
    for side, (name, lens) in enumerate(zip(camera_names(uid, cfg), lenses, strict=True)):
        if name in (*names, DEFAULT_VIEW):
            message = f"the scene has a camera {name!r} already: choose another name"
            raise ConfigError([Problem(f"sensors.{uid}", message)])
        at, turned = pos, quat
        if isinstance(cfg, StereoCameraCfg):
            offset, turn = pair_offset(cfg, side)
            at, turned = pos + quat_rotate(quat, offset), quat_multiply(quat, turn)
        camera = parent.add_camera(name=name, pos=at, quat=turned)
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
    found: NDArray[np.int32] = np.append(root[model.geom_bodyid], -1).astype(np.int32)
    return found


def _points(cfg: ExtrinsicsCfg) -> tuple[F64, F64, F64]:
    up = (0.0, 0.0, 1.0) if cfg.up is None else cfg.up
    eye, target, above = (np.asarray(v, np.float64) for v in (cfg.eye, cfg.target, up))
    return eye, target, above


def _pose(cfg: CameraCfg) -> tuple[F64, F64]:
    """Position and wxyz orientation (OpenGL's axes) in the frame of the body."""
    given: Any = cfg.extrinsics
    if given.eye is not None:
        eye, target, up = _points(given)
        return eye, matrix_to_quat(look_at(eye, target, up))
    quat = normalize_quat(np.asarray(given.quat, np.float64))
    if cfg.convention == "ros":
        quat = quat_multiply(quat, _FROM_ROS)
    return np.asarray(given.pos, np.float64), quat
