"""Camera views of a task: cameras of the model, placed when the model is compiled."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import Known
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.appearance import FOVY
from embodichain.lab.sim.compiler.scene.known import find_place
from embodichain.lab.sim.compiler.scene.world import PREFIX, WORLD, World
from embodichain.lab.sim.configs.scene_cfg import DEFAULT_VIEW, ViewCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "DEFAULT_VIEW",
    "add_views",
    "check_views",
    "place_views",
    "places_of_views",
    "scene_bounds",
]

_DIRECTION = (1.0, -0.8, 0.45)
"""From the scene to the camera, unless the task says otherwise: front, right, above."""
_ASPECT = 4.0 / 3.0
_MARGIN = 1.2
"""Width of the picture over that of what it shows."""
_HIDDEN_GROUP = 3
_FIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_FIXED = mujoco.mjtCamLight.mjCAMLIGHT_FIXED
_TRACK = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
_OPTICS = (
    "fovy",
    "proj",
    "resolution",
    "sensor_size",
    "focal_length",
    "focal_pixel",
    "principal_length",
    "principal_pixel",
)


def check_views(
    views: Mapping[str, ViewCfg],
    cameras: Collection[str],
    bodies: Collection[str] | None,
    known: Known | None = None,
) -> list[Problem]:
    """Return every mistake in views, with paths relative to them.

    Args:
        views: The views by name.
        cameras: The cameras of files and sensors.
        bodies: Entities and links that a view may follow; None if not all are known: then unknown
            ones, and unknown cameras, are not mistakes.
        known: The declared entities, for sites and geoms that a view may follow.
    """
    problems: list[Problem] = []
    for name, cfg in views.items():
        mistakes = cfg.check()
        if "/" in name:
            message = "a view's name must not contain '/', as those of files do"
            mistakes.append(Problem("", message))
        elif name in cameras:
            mistakes.append(Problem("", f"a camera is called {name!r}: choose another name"))
        if bodies is not None:
            mistakes += _check_references(cfg, cameras, bodies, known or {})
        problems += [mistake.below(name) for mistake in mistakes]
    return problems


def _check_references(
    cfg: ViewCfg, cameras: Collection[str], bodies: Collection[str], known: Known
) -> list[Problem]:
    """Return a view's references to cameras and bodies that do not exist, with paths below it."""
    problems: list[Problem] = []
    if cfg.camera is not None and cfg.camera not in cameras:
        message = f"no camera is called {cfg.camera!r}"
        problems.append(_unknown("camera", message, cfg.camera, cameras))
    for number, uid in enumerate(cfg.show or ()):
        if uid not in bodies or "/" in uid:
            message = f"no entity is called {uid!r}"
            entities = [name for name in bodies if "/" not in name]
            problems.append(_unknown(f"show.{number}", message, uid, entities))
    if cfg.body is not None and cfg.body not in bodies:
        place, mistakes = find_place(cfg.body, known)
        problems += [Problem("body", mistake.message, mistake.hint) for mistake in mistakes]
        uid, _, _ = cfg.body.partition("/")
        is_entity = known.get(uid, "light") != "light"  # then its own config or file is wrong
        if place is None and not mistakes and not is_entity:
            message = f"no entity or link is called {cfg.body!r}"
            problems.append(_unknown("body", message, cfg.body, bodies))
    return problems


def _unknown(key: str, message: str, name: str, names: Collection[str]) -> Problem:
    """Return the problem that a name is none of some names."""
    existing = listing([*names], name) or "none"
    return Problem(key, f"{message}; there are: {existing}", did_you_mean(name, names).strip())


def places_of_views(
    known: Known, world: World | None, incomplete: bool
) -> tuple[list[str], list[str] | None]:
    """Return the cameras of files, and the entities and links that a view may follow.

    Args:
        known: The declared entities.
        world: The scene's file.
        incomplete: Whether there may be more entities; then the second is None.
    """
    cameras: list[str] = []
    bodies: list[str] = []
    if world is not None:
        cameras += [f"{WORLD}/{camera.name}" for camera in world.spec.cameras]
        bodies += [f"{WORLD}/{body.name}" for body in world.spec.bodies[1:]]
    for uid, entity in known.items():
        if isinstance(entity, ParsedArticulation):
            cameras += [f"{uid}/{camera.name}" for camera in entity.spec.cameras]
            bodies += [uid, *(f"{uid}/{link}" for link in entity.link_names)]
        elif entity != "light":
            bodies.append(uid)
    return cameras, None if incomplete else bodies


def add_views(
    spec: mujoco.MjSpec, views: Mapping[str, ViewCfg], roots: Mapping[str, str], known: Known
) -> None:
    """Add a camera for each view, and the default one.

    A view that follows a site or a geom is on a body without mass, ``views/NAME``, at its pose.

    Args:
        spec: The scene with all its bodies.
        views: The declared views.
        roots: Uid -> the name of its root body.
        known: The entities.

    Raises:
        ConfigError: If a view is wrong; lists every mistake.
    """
    cameras = {camera.name: camera for camera in spec.cameras}
    bodies = {body.name: body for body in spec.bodies if body.name != "world"}
    bodies |= {uid: bodies[root] for uid, root in roots.items()}
    problems = check_views(views, cameras, bodies, known)
    if problems:
        raise ConfigError(p.below("views") for p in problems)
    for name, cfg in _with_default(views).items():
        if cfg.camera is not None:
            _copy_camera(cameras[cfg.camera], name, cfg.fovy)
            continue
        if cfg.body is None:
            body = spec.worldbody
        elif cfg.body in bodies:
            body = bodies[cfg.body]
        else:
            body = _body_on_frame(spec, f"views/{name}", cfg.body, known)
        camera = body.add_camera(name=name, fovy=FOVY if cfg.fovy is None else float(cfg.fovy))
        follows_position = cfg.body is not None and cfg.follow == "position"
        camera.mode = _TRACK if follows_position else _FIXED


def _body_on_frame(spec: mujoco.MjSpec, name: str, frame: str, known: Known) -> mujoco.MjsBody:
    """The body of a link that a robot's `names` have, ``ENTITY/NAME``.

    For a site or a geom it is a new body without mass at its pose.
    """
    place, _ = find_place(frame, known)
    if place is None:
        raise RuntimeError(f"{frame!r} was found before")
    if place.is_origin:
        return spec.body(place.body)
    return spec.body(place.body).add_body(name=name, pos=place.pos, quat=place.quat)


def _with_default(views: Mapping[str, ViewCfg]) -> dict[str, ViewCfg]:
    return {DEFAULT_VIEW: ViewCfg(direction=_DIRECTION), **views}


def _copy_camera(camera: mujoco.MjsCamera, name: str, fovy: float | None) -> None:
    """Add a camera with another one's pose and optics."""
    copied = camera.parent.add_camera(name=name, pos=camera.pos, quat=camera.quat)
    copied.alt = camera.alt
    copied.mode = camera.mode
    copied.targetbody = camera.targetbody
    for field in _OPTICS:
        setattr(copied, field, getattr(camera, field))
    if fovy is not None:
        copied.fovy = float(fovy)
        copied.sensor_size = [0.0, 0.0]  # with a size, MuJoCo ignores fovy


def place_views(
    spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, views: Mapping[str, ViewCfg]
) -> None:
    """Aim the cameras of views, at the initial state.

    Args:
        spec: The scene; its cameras are set too, for saved files.
        model: The compiled scene; its cameras are changed.
        data: The initial state, with positions computed.
        views: The declared views.
    """
    points = _shown_points(model, data)
    bodies = [model.body(i).name for i in range(model.nbody)]
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    at_rest = mujoco.MjData(model)
    mujoco.mj_kinematics(model, at_rest)
    for name, cfg in _with_default(views).items():
        if cfg.camera is not None:
            continue
        camera = model.camera(name)
        if cfg.direction is not None:
            axes = _look_axes(np.asarray(cfg.direction, np.float64), cfg.up)
            shown = points
            if cfg.show is not None:
                shown = _shown_points(model, data, _bodies_of(cfg.show, bodies))
            margin = _MARGIN if cfg.margin is None else float(cfg.margin)
            slope = math.tan(math.radians(float(camera.fovy[0])) / 2.0) / margin
            pos = _stand_back(shown, axes, slope, cfg.target)
        else:
            pos = np.asarray(cfg.eye, np.float64)
            axes = _look_axes(pos - _target(cfg, middle), cfg.up)
        if int(camera.mode[0]) == int(_TRACK):
            # MuJoCo keeps the offset and the axes that a tracking camera has in qpos0.
            body_axes = at_rest.xmat[camera.bodyid[0]].reshape(3, 3)
            pos = body_axes.T @ pos
            axes = body_axes.T @ axes
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.reshape(9))
        camera.pos[:] = pos
        camera.quat[:] = quat
        spec.camera(name).pos = pos
        spec.camera(name).quat = quat
    _derive_cameras(model)


def _bodies_of(uids: Sequence[str], bodies: Sequence[str]) -> list[int]:
    """The ids of the bodies of entities; those of a scene's file have its prefix."""
    names = {f"{PREFIX}{uid}" for uid in uids} | {*uids}
    beginnings = tuple(f"{uid}/" for uid in uids)
    return [i for i, name in enumerate(bodies) if name in names or name.startswith(beginnings)]


def _target(cfg: ViewCfg, middle: F64) -> F64:
    """Return the point (3,) that a camera at a point looks at; `middle` is that of the scene."""
    if cfg.target is not None:
        return np.asarray(cfg.target, np.float64)
    if cfg.body is not None:
        return np.zeros(3)
    return middle


def _derive_cameras(model: mujoco.MjModel) -> None:
    """Recompute what MuJoCo derives from the poses of cameras, and nothing else."""
    derived = copy.copy(model)
    mujoco.mj_setConst(derived, mujoco.MjData(derived))
    for field in ("cam_pos0", "cam_poscom0", "cam_mat0"):
        getattr(model, field)[:] = getattr(derived, field)


def _look_axes(back: F64, up: Sequence[float]) -> F64:
    """(3, 3) columns right, up, backwards of a camera; another `up` if it is parallel to the view.

    Raises:
        ConfigError: If the camera is at the point it looks at.
    """
    length = float(np.linalg.norm(back))
    if length < 1e-9:
        raise ConfigError([Problem("views", "a camera is at the point it looks at")])
    back = back / length
    for upward in (np.asarray(up, np.float64), np.eye(3)[0], np.eye(3)[1]):
        right = np.cross(upward, back)
        size = float(np.linalg.norm(right))
        if size > 1e-6 * float(np.linalg.norm(upward)):
            right /= size
            break
    return np.stack([right, np.cross(back, right), back], axis=1)


def _stand_back(points: F64, axes: F64, slope: float, target: Sequence[float] | None) -> F64:
    """Return the camera position (3,) from which points (n, 3) just fill the picture.

    `slope` is that of the picture's upper side over the distance. With slope t of a side of the
    view, a camera at (a, c) in the plane of one axis and the view shows a point (x, z) if
    |x - a| <= t (c - z), so t c + a >= max(x + t z) = high and t c - a >= max(t z - x) = low. The
    nearest camera has a = (high - low) / 2; `target` fixes a.
    """
    local = points @ axes
    aim = None if target is None else np.asarray(target, np.float64) @ axes
    eye = np.zeros(3)
    depth = -np.inf
    for axis, t in ((0, slope * _ASPECT), (1, slope)):
        low = float((t * local[:, 2] - local[:, axis]).max())
        high = float((t * local[:, 2] + local[:, axis]).max())
        eye[axis] = 0.5 * (high - low) if aim is None else aim[axis]
        depth = max(depth, (high - eye[axis]) / t, (low + eye[axis]) / t)
    eye[2] = depth
    return axes @ eye


# ------------------------------------------------------------------------------------------- bounds


def scene_bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64, float]:
    """Return centre and radius of a sphere around what views show; the radius is at least 0.15."""
    points = _shown_points(model, data)
    low = points.min(axis=0)
    high = points.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low))
    return 0.5 * (low + high), max(radius, 0.15)


def _shown_points(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int] | None = None
) -> F64:
    """(n, 3) corners of the boxes around the drawn shapes of bodies above the ground; None: all.

    Terrains and shapes of the world itself, such as grounds and walls, count only if there are no
    others. A scene without any has a box of 60 cm at the origin.
    """
    is_drawn = (model.geom_rbound > 0) & (model.geom_group < _HIDDEN_GROUP)
    is_drawn &= model.geom_rgba[:, 3] > 0
    is_of_body = is_drawn & (model.geom_bodyid > 0) & (model.geom_type != _FIELD)
    if bodies is not None:
        is_of_body &= np.isin(model.geom_bodyid, bodies)
    geoms = np.flatnonzero(is_of_body if is_of_body.any() else is_drawn)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    if not len(geoms):
        return 0.3 * (signs + np.array([0, 0, 1]))
    boxes = model.geom_aabb[geoms]
    corners = boxes[:, None, :3] + signs * boxes[:, None, 3:]
    axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
    points: F64 = (data.geom_xpos[geoms, None] + corners @ axes.transpose(0, 2, 1)).reshape(-1, 3)
    if points[:, 2].max() > 0:
        points[:, 2] = np.maximum(points[:, 2], 0.0)
    return points
