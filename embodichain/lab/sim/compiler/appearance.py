"""What a scene looks like beside its entities: sky, ambient light, lights, ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import GROUND
from embodichain.lab.sim.compiler.rigid_objects import check_pose, initial_pose
from embodichain.lab.sim.scene_cfg import GroundCfg, LightCfg, SceneCfg, SkyCfg
from embodichain.utils.errors import Problem

__all__ = ["SUN", "add_ground", "add_lights", "check_light", "place_lights", "set_look"]

SUN = "default"
"""Name of the light of a scene that declares none."""
FOVY = 40.0
"""Default vertical field of view in degrees."""
_FULL_INTENSITY = 30.0
_AMBIENT, _HEADLIGHT = 0.33, 0.38
_LIGHTS = {
    "point": mujoco.mjtLightType.mjLIGHT_POINT,
    "sun": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "direction": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "directional": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "spot": mujoco.mjtLightType.mjLIGHT_SPOT,
}
_COLORS: dict[str, Sequence[Sequence[float]]] = {
    "checker": ((0.72, 0.74, 0.76), (0.66, 0.68, 0.71)),
    "wood": ((0.76, 0.62, 0.46), (0.55, 0.40, 0.27)),
    "plain": ((0.70, 0.72, 0.74),),
}
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


def set_look(spec: mujoco.MjSpec, cfg: SceneCfg) -> None:
    """Set sky, haze, ambient light and sizes; what an MJCF world has stays unless `cfg` gives it.

    Args:
        spec: The scene, with the world of `cfg.fpath` already in it.
        cfg: The look.
    """
    visual = spec.visual
    visual.global_.offwidth = max(visual.global_.offwidth, 1920)
    visual.global_.offheight = max(visual.global_.offheight, 1440)
    visual.quality.shadowsize = 4096
    own = not cfg.fpath
    if own:
        visual.global_.fovy = FOVY
        visual.map.znear, visual.map.zfar = 0.01, 60.0
        visual.map.fogstart, visual.map.fogend = 6.0, 20.0
        visual.headlight.specular = [0.05, 0.05, 0.05]
    if own or cfg.ambient is not None:
        level = _AMBIENT if cfg.ambient is None else float(cfg.ambient)
        visual.headlight.ambient = [0.97 * level, level, min(1.06 * level, 1.0)]
    if own or cfg.headlight is not None:
        visual.headlight.diffuse = 3 * [_HEADLIGHT if cfg.headlight is None else cfg.headlight]
    skies = [t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    if skies and cfg.sky is None:
        return
    for texture in skies:
        spec.delete(texture)
    sky = cfg.sky or SkyCfg()
    visual.rgba.haze = [*(float(c) for c in sky.horizon), 1.0]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[float(c) for c in sky.top],
        rgb2=[float(c) for c in sky.horizon],
        width=256,
        height=1536,
    )


# ------------------------------------------------------------------------------------------- ground


def add_ground(spec: mujoco.MjSpec, cfg: GroundCfg) -> None:
    """Add the ground plane at z = 0."""
    colors = [[float(c) for c in rgb] for rgb in cfg.colors or _COLORS[cfg.type]]
    material = spec.add_material(name=GROUND, reflectance=float(cfg.reflectance))
    material.texuniform = True
    if cfg.type == "plain":
        material.rgba = [*colors[0], 1.0]
    elif cfg.type == "wood":
        # Imported here: few scenes need it.
        from embodichain.lab.sim.compiler.wood import WOOD_LENGTH, add_wood

        add_wood(spec, GROUND, colors[0], colors[-1], planks=True)
        material.textures[_RGB] = GROUND
        material.texrepeat = 2 * [1.0 / (WOOD_LENGTH * float(cfg.tile))]
        material.specular, material.shininess = 0.15, 0.3
    else:
        mark = 0.8 * np.minimum(colors[0], colors[-1])
        spec.add_texture(
            name=GROUND,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            mark=mujoco.mjtMark.mjMARK_EDGE,
            rgb1=colors[0],
            rgb2=colors[-1],
            markrgb=mark.tolist(),
            width=512,
            height=512,
        )
        material.textures[_RGB] = GROUND
        material.texrepeat = 2 * [0.5 / float(cfg.tile)]
    edge = 0.0 if cfg.size is None else 0.5 * float(cfg.size)
    spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[edge, edge, 1.0],
        material=GROUND,
    )


# ------------------------------------------------------------------------------------------- lights


def check_light(cfg: LightCfg) -> list[Problem]:
    """Return every mistake in a light's config, with paths below it."""
    problems = check_pose(cfg)
    color, direction = np.asarray(cfg.color, np.float64), np.asarray(cfg.direction, np.float64)
    if not ((color >= 0) & (color <= 1)).all():
        problems.append(Problem("color", f"RGB in [0, 1], got {color.tolist()}"))
    if not cfg.intensity >= 0:
        problems.append(Problem("intensity", f"must not be negative, got {cfg.intensity}"))
    if not (np.isfinite(direction).all() and np.linalg.norm(direction) > 1e-9):
        problems.append(Problem("direction", f"must not be zero, got {direction.tolist()}"))
    return problems


def add_lights(spec: mujoco.MjSpec, lights: Mapping[str, LightCfg]) -> None:
    """Add the declared lights; if there are none in the scene, a sun with soft shadows."""
    if not lights and not spec.lights:
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
            castshadow=cfg.light_type != "point" if cfg.shadow is None else cfg.shadow,
            cutoff=float(cfg.cutoff),
        )


def place_lights(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    lights: Mapping[str, LightCfg],
    center: F64,
    radius: float,
) -> None:
    """Move declared directional lights, or the default sun, near the scene.

    The shadow map of a directional light covers only the surroundings of its position.

    Args:
        spec: The scene; its lights are moved too, for saved files.
        model: The compiled scene.
        lights: The declared lights.
        center: (3,) the middle of the scene.
        radius: Of a sphere around it, metres.
    """
    directional = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    for name in lights or [SUN]:
        written = spec.light(name)
        if written is None or int(written.type) != directional:
            continue
        light = model.light(name)
        light.pos[:] = written.pos = center - 2.0 * radius * light.dir
        light.pos0[:] = light.poscom0[:] = light.pos
