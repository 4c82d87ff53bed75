"""How a scene looks: sky, ground, haze, surfaces, lights, and the camera called ``default``."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import LightCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.rigid_math import initial_pose
from embodichain.lab.sim.shapes import VisualMaterialCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "CAMERA",
    "GROUND",
    "add_ground",
    "add_lights",
    "aim_camera",
    "check_light",
    "set_look",
    "surface",
]

CAMERA = "default"
GROUND = "default_plane"
SUN = "default"

_PALETTE = (
    (0.86, 0.36, 0.26),
    (0.25, 0.55, 0.75),
    (0.93, 0.69, 0.25),
    (0.38, 0.65, 0.42),
    (0.58, 0.44, 0.69),
)
_FULL_INTENSITY = 30.0
_FOVY = 40.0
_VIEW = np.array([1.0, -0.8, 0.32])
"""From the scene towards the camera: front, right, above."""
_LIGHTS = {
    "point": mujoco.mjtLightType.mjLIGHT_POINT,
    "sun": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "direction": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "spot": mujoco.mjtLightType.mjLIGHT_SPOT,
}


def set_look(spec: mujoco.MjSpec) -> None:
    """Set sky, haze, ambient light and sizes; add the camera, which `aim_camera` places."""
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 1920, 1440
    visual.global_.fovy = _FOVY
    visual.quality.shadowsize = 4096
    visual.map.znear, visual.map.zfar = 0.01, 60.0
    visual.map.fogstart, visual.map.fogend = 6.0, 20.0
    visual.headlight.ambient = [0.32, 0.33, 0.35]
    visual.headlight.diffuse = [0.38, 0.38, 0.38]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.rgba.haze = [0.80, 0.86, 0.92, 1.0]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.42, 0.56, 0.72],
        rgb2=[0.86, 0.90, 0.94],
        width=256,
        height=1536,
    )
    spec.worldbody.add_camera(name=CAMERA, fovy=_FOVY)


def add_ground(spec: mujoco.MjSpec) -> None:
    """Add the ground plane at z = 0, with tiles of one metre."""
    spec.add_texture(
        name=GROUND,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.72, 0.74, 0.76],
        rgb2=[0.66, 0.68, 0.71],
        markrgb=[0.55, 0.57, 0.60],
        width=512,
        height=512,
    )
    material = spec.add_material(
        name=GROUND, texuniform=True, texrepeat=[0.5, 0.5], reflectance=0.08
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = GROUND
    spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        material=GROUND,
    )


def surface(spec: mujoco.MjSpec, uid: str, cfg: VisualMaterialCfg | None, number: int) -> str:
    """Add an object's material and return its name; without a config, a colour of its own."""
    name = f"{uid}/material"
    if cfg is None:
        rgba = [*_PALETTE[number % len(_PALETTE)], 1.0]
        spec.add_material(name=name, rgba=rgba, specular=0.2, shininess=0.3)
        return name
    spec.add_material(
        name=name,
        rgba=[float(c) for c in cfg.base_color],
        specular=0.5 * (1.0 - float(cfg.roughness)),
        shininess=1.0 - float(cfg.roughness),
        metallic=float(cfg.metallic),
        roughness=float(cfg.roughness),
        emission=float(cfg.emissive_intensity) * float(max(cfg.emissive)),
    )
    return name


def check_light(cfg: LightCfg) -> list[Problem]:
    """Return every mistake in a light's config, with paths below it."""
    problems: list[Problem] = []
    try:
        initial_pose(cfg)
    except ConfigError as error:
        problems += error.problems
    color, direction = np.asarray(cfg.color, np.float64), np.asarray(cfg.direction, np.float64)
    if not ((color >= 0) & (color <= 1)).all():
        problems.append(Problem("color", f"RGB in [0, 1], got {color.tolist()}"))
    if not cfg.intensity >= 0:
        problems.append(Problem("intensity", f"must not be negative, got {cfg.intensity}"))
    if not (np.isfinite(direction).all() and np.linalg.norm(direction) > 1e-9):
        problems.append(Problem("direction", f"must not be zero, got {direction.tolist()}"))
    return problems


def add_lights(spec: mujoco.MjSpec, lights: Mapping[str, LightCfg]) -> None:
    """Add the declared lights, or a sun with soft shadows if there are none."""
    if not lights:
        spec.worldbody.add_light(
            name=SUN,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 6.0],
            dir=[-0.35, 0.45, -1.0],
            diffuse=[0.62, 0.61, 0.58],
            specular=[0.2, 0.2, 0.2],
            castshadow=True,
        )
    for uid, cfg in lights.items():
        strength = np.asarray(cfg.color, np.float64) * (float(cfg.intensity) / _FULL_INTENSITY)
        spec.worldbody.add_light(
            name=uid,
            type=_LIGHTS[cfg.light_type],
            pos=initial_pose(cfg)[0],
            dir=[float(x) for x in cfg.direction],
            diffuse=strength,
            specular=0.3 * strength,
            castshadow=cfg.light_type != "point",
        )


def aim_camera(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Place camera ``default`` so that everything but endless planes is in its picture.

    Args:
        spec: The scene; its camera is set too, for what is saved of it.
        model: The compiled scene; its camera is changed.
        data: The scene as it starts, positions computed.
    """
    center, radius = _bounds(model, data)
    back = _VIEW / np.linalg.norm(_VIEW)
    distance = radius / np.sin(np.radians(_FOVY / 2))
    pos = center + distance * back
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.stack([right, np.cross(back, right), back], axis=1)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, matrix.reshape(9))
    camera = model.camera(CAMERA)
    camera.pos[:], camera.quat[:] = pos, quat
    camera.pos0[:], camera.poscom0[:], camera.mat0[:] = pos, pos, matrix.reshape(9)
    written = spec.camera(CAMERA)
    written.pos, written.quat = pos, quat
    _aim_sun(spec, model, center, radius)
    for stat in (model.stat, spec.stat):
        stat.extent, stat.center = max(2.0 * radius, 1.0), center


def _aim_sun(spec: mujoco.MjSpec, model: mujoco.MjModel, center: F64, radius: float) -> None:
    """Move the default light close: its shadow map spans what lies around its position."""
    sun = spec.light(SUN)
    if sun is not None:
        light = model.light(SUN)
        light.pos[:] = sun.pos = center - 2.0 * radius * light.dir
        light.pos0[:] = light.poscom0[:] = light.pos


def _bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64, float]:
    """Return centre and radius of a ball around all geoms that end somewhere."""
    finite = np.flatnonzero(model.geom_rbound > 0)
    if not len(finite):
        return np.array([0.0, 0.0, 0.3]), 1.0
    reach = model.geom_rbound[finite, None]
    low = (data.geom_xpos[finite] - reach).min(axis=0)
    high = (data.geom_xpos[finite] + reach).max(axis=0)
    low[2] = max(low[2], 0.0) if high[2] > 0 else low[2]
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 0.15)
