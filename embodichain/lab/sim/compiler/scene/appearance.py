"""What a scene looks like beside its entities: sky, ambient light, lights, ground."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping, Sequence
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    check_fixed_contact,
    fixed_contact,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import GROUND, SUN
from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, LightCfg, SceneCfg, SkyCfg
from embodichain.utils.errors import Problem

__all__ = [
    "FOVY",
    "WOOD_LENGTH",
    "add_ground",
    "add_lights",
    "add_wood",
    "check_ground",
    "check_light",
    "place_lights",
    "set_look",
    "wood",
]

FOVY = 40.0
"""Default vertical field of view in degrees."""
_FULL_INTENSITY = 30.0
_AMBIENT = 0.33
_HEADLIGHT = 0.38
_LIGHTS = {
    "point": mujoco.mjtLightType.mjLIGHT_POINT,
    "sun": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "direction": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "directional": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "spot": mujoco.mjtLightType.mjLIGHT_SPOT,
}
_COLORS: dict[str, Sequence[Sequence[float]]] = {
    "checker": ((0.72, 0.74, 0.76), (0.66, 0.68, 0.71)),
    "grid": ((0.62, 0.65, 0.69), (0.50, 0.53, 0.57)),
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
    has_file = bool(cfg.fpath)
    if not has_file:
        visual.global_.fovy = FOVY
        visual.map.znear = 0.01
        visual.map.zfar = 60.0
        visual.map.fogstart = 6.0
        visual.map.fogend = 20.0
        visual.headlight.specular = [0.05, 0.05, 0.05]
    if not has_file or cfg.ambient is not None:
        level = _AMBIENT if cfg.ambient is None else float(cfg.ambient)
        visual.headlight.ambient = [0.97 * level, level, min(1.06 * level, 1.0)]
    if not has_file or cfg.headlight is not None:
        level = _HEADLIGHT if cfg.headlight is None else float(cfg.headlight)
        visual.headlight.diffuse = 3 * [level]
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


def check_ground(cfg: SceneCfg) -> list[Problem]:
    """Return every mistake in the contact parameters of a scene's ground, with paths below it."""
    ground = cfg.ground
    if ground is None:
        return []
    names = [f.name for f in dataclasses.fields(ContactCfg) if getattr(ground, f.name) is not None]
    if cfg.terrain is not None:
        message = "the terrain is the ground that things touch: give it in scene.terrain"
        return [Problem(f"ground.{name}", message) for name in names]
    if ground.type == "none":
        return [Problem(f"ground.{name}", "there is no ground: type is none") for name in names]
    return [p.below("ground") for p in check_fixed_contact(ground)]


def add_ground(spec: mujoco.MjSpec, cfg: GroundCfg) -> None:
    """Add the ground plane at z = 0. What stands on it decides, unless a friction is given."""
    colors = [[float(c) for c in rgb] for rgb in cfg.colors or _COLORS[cfg.type]]
    material = spec.add_material(name=GROUND, reflectance=float(cfg.reflectance))
    material.texuniform = True
    if cfg.type == "plain":
        material.rgba = [*colors[0], 1.0]
    elif cfg.type == "grid":
        _add_grid(spec, colors[0], colors[-1])
        material.textures[_RGB] = GROUND
        material.texrepeat = _repeats(float(cfg.tile))
        material.specular = 0.1
        material.shininess = 0.2
    elif cfg.type == "wood":
        add_wood(spec, GROUND, colors[0], colors[-1], planks=True)
        material.textures[_RGB] = GROUND
        material.texrepeat = _repeats(WOOD_LENGTH * float(cfg.tile))
        material.specular = 0.15
        material.shininess = 0.3
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
        material.texrepeat = _repeats(2.0 * float(cfg.tile))  # an image has two tiles a side
    edge = 0.0 if cfg.size is None else 0.5 * float(cfg.size)
    plane = spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[edge, edge, 1.0],
        material=GROUND,
    )
    set_contact_parameters([plane], fixed_contact(cfg))


def _repeats(width: float) -> list[float]:
    """How often a plane repeats an image that covers `width` metres along x and y."""
    return 2 * [2.0 / width]  # at 1, MuJoCo draws an image every 2 m


# --------------------------------------------------------------------------------------------- grid

_GRID_PIXELS = 1000
_GRID_CELLS = 5
"""Cells of a tile, in each direction."""
_GRID_EDGE = 6
"""Pixels: width of the lines between tiles."""
_GRID_LINE = 3
"""Pixels: width of the lines between cells."""


def _add_grid(spec: mujoco.MjSpec, tile: Sequence[float], line: Sequence[float]) -> None:
    """Add the texture of one tile with its lines; opposite edges match."""
    file = f"{GROUND}_grid.png"
    spec.assets = {**spec.assets, file: _grid_png(tuple(tile), tuple(line))}
    spec.add_texture(name=GROUND, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)


@cache
def _grid_png(tile: tuple[float, ...], line: tuple[float, ...]) -> bytes:
    strength = np.zeros((_GRID_PIXELS, _GRID_PIXELS), np.uint8)
    place = np.arange(_GRID_PIXELS)
    cell = _GRID_PIXELS // _GRID_CELLS
    is_fine = (place + _GRID_LINE // 2) % cell < _GRID_LINE
    is_edge = (place + _GRID_EDGE // 2) % _GRID_PIXELS < _GRID_EDGE
    strength[is_fine[:, None] | is_fine] = 1
    strength[is_edge[:, None] | is_edge] = 2
    shades = [np.asarray(tile), 0.5 * (np.asarray(tile) + np.asarray(line)), np.asarray(line)]
    return _png_of(strength, 255.0 * np.stack(shades))


def _png_of(indices: NDArray[np.uint8], palette: F64) -> bytes:
    """A PNG with a palette of (n, 3) colours in 0 to 255."""
    from PIL import Image

    image = Image.fromarray(indices, mode="P")
    image.putpalette(np.round(palette).astype(np.uint8).tobytes())
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


# --------------------------------------------------------------------------------------------- wood

WOOD_LENGTH = 1.0
"""Lengths of a plank that one image shows along x (and along y)."""
_WOOD_PIXELS = 512
_PLANKS = 8
"""Planks of one image across y."""
_WOOD_SHADES = 24
"""Shades: more are not visible, and cost 3 kB a shade in every log."""


def add_wood(
    spec: mujoco.MjSpec,
    name: str,
    light: Sequence[float],
    dark: Sequence[float],
    *,
    planks: bool,
) -> None:
    """Add a wood texture to a scene.

    Args:
        spec: The scene; the image becomes one of its assets.
        name: The texture's name.
        light: RGB in [0, 1].
        dark: RGB in [0, 1], of the grain.
        planks: Whether it shows planks with joints, or one board.
    """
    file = f"{name}_wood.png"
    spec.assets = {**spec.assets, file: _png(tuple(light), tuple(dark), planks)}
    flat = mujoco.mjtTexture.mjTEXTURE_2D
    spec.add_texture(name=name, type=flat, file=file)


@cache
def _png(light: tuple[float, ...], dark: tuple[float, ...], planks: bool) -> bytes:
    shade = np.arange(_WOOD_SHADES + 1)[:, None] / _WOOD_SHADES
    palette = 255.0 * (np.asarray(light) * shade + np.asarray(dark) * (1.0 - shade))
    return _png_of(np.round(_WOOD_SHADES * wood(planks)).astype(np.uint8), palette)


def wood(planks: bool) -> F64:
    """Return (512, 512) lightness in [0, 1]; the grain runs along x, and opposite edges match."""
    rng = np.random.default_rng(7)
    rows = np.arange(_WOOD_PIXELS)
    board = rows * _PLANKS // _WOOD_PIXELS if planks else np.zeros(_WOOD_PIXELS, np.int64)
    # Growth rings: stripes across the board, bent by slow noise.
    bend = _noise(rng, 150.0, 30.0)
    rings = np.sin(2.0 * np.pi * (rows[:, None] * 24.0 / _WOOD_PIXELS + 1.6 * bend))
    fibre = _noise(rng, 60.0, 0.7)
    shade = 0.62 + 0.10 * rings + 0.09 * fibre + 0.06 * _noise(rng, 100.0, 15.0)
    if planks:
        # Boards differ in their tint and in the part of the trunk that they show.
        shift = rng.integers(0, _WOOD_PIXELS, _PLANKS)[board]
        shade = np.take_along_axis(shade, (rows[None, :] + shift[:, None]) % _WOOD_PIXELS, axis=1)
        ends = rng.integers(0, _WOOD_PIXELS, _PLANKS)[board]
        tint = rng.uniform(-0.13, 0.13, (_PLANKS, 2))
        half = (rows[None, :] - ends[:, None]) % _WOOD_PIXELS < _WOOD_PIXELS // 2
        shade += np.where(half, tint[board, 0][:, None], tint[board, 1][:, None])
        across = rows % (_WOOD_PIXELS // _PLANKS) < 2
        along = (rows[None, :] - ends[:, None]) % (_WOOD_PIXELS // 2) < 2
        shade = np.where(across[:, None] | along, 0.35 * shade, shade)
    return np.clip(shade, 0.0, 1.0)


def _noise(rng: np.random.Generator, along: float, across: float) -> F64:
    """(512, 512) periodic Gaussian noise of unit variance, smooth over so many pixels."""
    white = np.fft.rfft2(rng.standard_normal((_WOOD_PIXELS, _WOOD_PIXELS)))
    fy = np.fft.fftfreq(_WOOD_PIXELS)[:, None]
    fx = np.fft.rfftfreq(_WOOD_PIXELS)[None, :]
    filtered = np.exp(-2.0 * (np.pi * np.hypot(fx * along, fy * across)) ** 2)
    smooth = np.fft.irfft2(white * filtered, (_WOOD_PIXELS, _WOOD_PIXELS))
    return smooth / smooth.std()


# ------------------------------------------------------------------------------------------- lights


def check_light(cfg: LightCfg) -> list[Problem]:
    """Return every mistake in a light's config, with paths below it."""
    return check_pose(cfg)


def add_lights(
    spec: mujoco.MjSpec, lights: Mapping[str, LightCfg], sun: float | None = None
) -> None:
    """Add the declared lights; if there are none in the scene, a sun of a strength."""
    if not lights and not spec.lights:
        brightness = 1.0 if sun is None else float(sun)
        spec.worldbody.add_light(
            name=SUN,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 6.0],
            dir=[-0.35, 0.45, -1.0],
            diffuse=[brightness * share for share in (0.62, 0.61, 0.58)],
            specular=3 * [0.2 * brightness],
            castshadow=True,
        )
    for uid, cfg in lights.items():
        casts_shadow = cfg.shadow
        if casts_shadow is None:
            casts_shadow = cfg.light_type != "point"
        strength = np.asarray(cfg.color, np.float64) * (float(cfg.intensity) / _FULL_INTENSITY)
        spec.worldbody.add_light(
            name=uid,
            type=_LIGHTS[cfg.light_type],
            pos=initial_pose(cfg)[0],
            dir=[float(x) for x in cfg.direction],
            diffuse=strength,
            specular=0.3 * strength,
            castshadow=casts_shadow,
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
        light_in_spec = spec.light(name)
        if light_in_spec is None or int(light_in_spec.type) != directional:
            continue
        light = model.light(name)
        pos = center - 2.0 * radius * light.dir
        light_in_spec.pos = pos
        light.pos[:] = pos
        # MuJoCo has derived these from the position before.
        light.pos0[:] = pos
        light.poscom0[:] = pos
