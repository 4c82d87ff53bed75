"""Camera views of a task: cameras of the model, placed when the model is compiled."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import Known
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.appearance import FOVY
from embodichain.lab.sim.compiler.scene.known import find_place
from embodichain.lab.sim.compiler.scene.world import WORLD, World
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
_PLACES = ("eye", "direction", "camera")
_FIXED, _TRACK = mujoco.mjtCamLight.mjCAMLIGHT_FIXED, mujoco.mjtCamLight.mjCAMLIGHT_TRACK
_OPTICS = (
    *("fovy", "proj", "resolution", "sensor_size"),
    *("focal_length", "focal_pixel", "principal_length", "principal_pixel"),
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
            ones, and unknown cameras, are no mistakes.
        known: The declared entities, for sites and geoms that a view may follow.
    """
    problems: list[Problem] = []
    for name, cfg in views.items():
        found = [Problem(f"{name}.{p.path}".rstrip("."), p.message) for p in _check_view(cfg)]
        if "/" in name:
            found.append(Problem(name, "a view's name must not contain '/', as those of files do"))
        elif name in cameras:
            found.append(Problem(name, f"a camera is called {name!r}: choose another name"))
        if bodies is not None:
            kinds = ("camera", "camera", cameras), ("body", "entity or link", bodies)
            for key, what, there in kinds:
                given = getattr(cfg, key)
                place, wrong = None, list[Problem]()
                if key == "body" and given is not None and given not in there:
                    place, wrong = find_place(given, known or {})
                if wrong:
                    found += [p.below(f"{name}.{key}") for p in wrong]
                elif given is not None and given not in there and place is None:
                    message = f"no {what} is called {given!r}; there are: "
                    message += listing([*there], given) or "none"
                    hint = did_you_mean(given, there).strip()
                    found.append(Problem(f"{name}.{key}", message, hint))
        problems += found
    return problems


def places_of_views(
    known: Known, world: World | None, incomplete: bool
) -> tuple[list[str], list[str] | None]:
    """Return the cameras of files, and the entities and links that a view may follow.

    Args:
        known: The declared entities.
        world: The scene's file.
        incomplete: Whether there may be more entities; then the second is None.
    """
    cameras = [] if world is None else [f"{WORLD}/{c.name}" for c in world.spec.cameras]
    bodies = [] if world is None else [f"{WORLD}/{b.name}" for b in world.spec.bodies[1:]]
    for uid, entity in known.items():
        if isinstance(entity, ParsedArticulation):
            cameras += [f"{uid}/{camera.name}" for camera in entity.spec.cameras]
            bodies += [uid, *(f"{uid}/{link}" for link in entity.link_names)]
        elif entity != "light":
            bodies.append(uid)
    return cameras, None if incomplete else bodies


def _check_view(cfg: ViewCfg) -> list[Problem]:
    """What is wrong with a view itself, with paths below it."""
    given = [name for name in _PLACES if getattr(cfg, name) is not None]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        return [Problem("", f"needs one of {', '.join(_PLACES)}, got {got}")]
    problems = []
    if cfg.camera is not None:
        fixed = {"target": cfg.target, "body": cfg.body}
        for name in (name for name, value in fixed.items() if value is not None):
            problems.append(Problem(name, "has no effect on a camera of a file: leave it out"))
    if cfg.follow != "position" and cfg.body is None:
        problems.append(Problem("follow", "belongs to body: the view follows nothing"))
    if cfg.direction is not None and cfg.body is not None:
        problems.append(Problem("body", "needs eye, relative to the body, not direction"))
    if cfg.direction is not None and not np.linalg.norm(cfg.direction) > 1e-9:
        problems.append(Problem("direction", f"must not be zero, got {list(cfg.direction)}"))
    if cfg.eye is not None and (cfg.target is not None or cfg.body is not None):
        target = (0.0, 0.0, 0.0) if cfg.target is None else cfg.target
        if np.allclose(cfg.eye, target):
            message = f"the camera is at the point it looks at, {[float(x) for x in cfg.eye]}"
            problems.append(Problem("eye", message))
    if not np.linalg.norm(cfg.up) > 1e-9:
        problems.append(Problem("up", f"must not be zero, got {list(cfg.up)}"))
    return problems


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
    own = {camera.name: camera for camera in spec.cameras}
    bodies = {body.name: body for body in spec.bodies if body.name != "world"}
    bodies |= {uid: bodies[root] for uid, root in roots.items()}
    problems = check_views(views, own, bodies, known)
    if problems:
        raise ConfigError(p.below("views") for p in problems)
    for name, cfg in _with_default(views).items():
        if cfg.camera is not None:
            _copy_camera(own[cfg.camera], name, cfg.fovy)
            continue
        body = spec.worldbody if cfg.body is None else bodies.get(cfg.body)
        if body is None:
            place, _ = find_place(cfg.body or "", known)
            if place is None:
                raise RuntimeError(f"{cfg.body!r} was found before")
            body = spec.body(place[0]).add_body(name=f"views/{name}", pos=place[1], quat=place[2])
        camera = body.add_camera(name=name, fovy=FOVY if cfg.fovy is None else float(cfg.fovy))
        camera.mode = _TRACK if cfg.body is not None and cfg.follow == "position" else _FIXED


def _with_default(views: Mapping[str, ViewCfg]) -> dict[str, ViewCfg]:
    return {DEFAULT_VIEW: ViewCfg(direction=_DIRECTION), **views}


def _copy_camera(camera: mujoco.MjsCamera, name: str, fovy: float | None) -> None:
    """Add a camera with another one's pose and optics."""
    made = camera.parent.add_camera(name=name, pos=camera.pos, quat=camera.quat)
    made.alt, made.mode, made.targetbody = camera.alt, camera.mode, camera.targetbody
    for field in _OPTICS:
        setattr(made, field, getattr(camera, field))
    if fovy is not None:
        made.fovy, made.sensor_size = float(fovy), [0.0, 0.0]


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
    shown = _shown(model, data)
    middle = 0.5 * (shown.min(axis=0) + shown.max(axis=0))
    at_rest = mujoco.MjData(model)
    mujoco.mj_kinematics(model, at_rest)
    for name, cfg in _with_default(views).items():
        if cfg.camera is not None:
            continue
        camera, written = model.camera(name), spec.camera(name)
        if cfg.direction is not None:
            back = np.asarray(cfg.direction, np.float64)
            axes = _axes(back, cfg.up)
            pos = _standing_back(shown, axes, float(camera.fovy[0]), cfg.target)
        else:
            pos = np.asarray(cfg.eye, np.float64)
            target = np.zeros(3) if cfg.body is not None else middle
            target = target if cfg.target is None else np.asarray(cfg.target, np.float64)
            axes = _axes(pos - target, cfg.up)
        if int(camera.mode[0]) == int(_TRACK):
            # MuJoCo keeps the offset and the axes that a tracking camera has in qpos0.
            body = at_rest.xmat[camera.bodyid[0]].reshape(3, 3)
            pos, axes = body.T @ pos, body.T @ axes
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.reshape(9))
        camera.pos[:] = written.pos = pos
        camera.quat[:] = written.quat = quat
    _derive_cameras(model)


def _derive_cameras(model: mujoco.MjModel) -> None:
    """Recompute what MuJoCo derives from the poses of cameras, and nothing else."""
    derived = copy.copy(model)
    mujoco.mj_setConst(derived, mujoco.MjData(derived))
    for field in ("cam_pos0", "cam_poscom0", "cam_mat0"):
        getattr(model, field)[:] = getattr(derived, field)


def _axes(back: F64, up: Sequence[float]) -> F64:
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


def _standing_back(shown: F64, axes: F64, fovy: float, target: Sequence[float] | None) -> F64:
    """Return the camera position (3,) from which points (n, 3) just fill the picture.

    With slope t of a side of the view, a camera at (a, c) in the plane of one axis and the view
    shows a point (x, z) if |x - a| <= t (c - z), so t c + a >= max(x + t z) = high and
    t c - a >= max(t z - x) = low. The nearest camera has a = (high - low) / 2; `target` fixes a.
    """
    local = shown @ axes
    aim = None if target is None else np.asarray(target, np.float64) @ axes
    slope = np.tan(np.radians(fovy) / 2.0) / _MARGIN
    at, depth = np.zeros(3), -np.inf
    for axis, t in ((0, slope * _ASPECT), (1, slope)):
        low = float((t * local[:, 2] - local[:, axis]).max())
        high = float((t * local[:, 2] + local[:, axis]).max())
        at[axis] = 0.5 * (high - low) if aim is None else aim[axis]
        depth = max(depth, (high - at[axis]) / t, (low + at[axis]) / t)
    at[2] = depth
    return axes @ at


# ------------------------------------------------------------------------------------------- bounds


def scene_bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64, float]:
    """Return centre and radius of a sphere around what views show; the radius is at least 0.15."""
    shown = _shown(model, data)
    low, high = shown.min(axis=0), shown.max(axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 0.15)


def _shown(model: mujoco.MjModel, data: mujoco.MjData) -> F64:
    """(n, 3) corners of the boxes around the drawn shapes of bodies above the ground.

    Terrains and shapes of the world itself, such as grounds and walls, count only if there are no
    others. A scene without any has a box of 60 cm at the origin.
    """
    drawn = (model.geom_rbound > 0) & (model.geom_group < _HIDDEN_GROUP)
    drawn &= model.geom_rgba[:, 3] > 0
    of_bodies = drawn & (model.geom_bodyid > 0) & (model.geom_type != _FIELD)
    geoms = np.flatnonzero(of_bodies if of_bodies.any() else drawn)
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
