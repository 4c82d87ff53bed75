"""The table and the pedestal of a scene: static rigid objects."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import RigidBodyAttributesCfg, RigidObjectCfg
from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    check_fixed_contact,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.geoms.shape_geoms import set_collision
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.scene.appearance import WOOD_LENGTH, add_wood
from embodichain.lab.sim.compiler.scene.object_contacts import object_contact
from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.lab.sim.configs.scene_cfg import PedestalCfg, SceneCfg, TableCfg
from embodichain.lab.sim.shapes import CubeCfg, CylinderCfg, VisualMaterialCfg
from embodichain.utils.errors import Problem

__all__ = ["PEDESTAL", "TABLE", "check_furniture", "finish_table", "furniture_of"]

TABLE = "table"
"""The uid of the table."""
PEDESTAL = "pedestal"
"""The uid of the pedestal."""
_PEDESTAL_WIDTH = 0.2
"""Metres, unless the config gives a size."""
_LEG_WIDTH = 0.06
"""Metres; the legs of a small table are thinner."""
_METAL = (0.25, 0.26, 0.28, 1.0)
_GRAIN = 0.62
"""Brightness of the grain over that of the wood."""
_BOARD = 1.2
"""Metres of a board that an image of wood covers."""
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


def finish_table(spec: mujoco.MjSpec, cfg: TableCfg) -> None:
    """Add four legs to the table's body, and wood to its top.

    Args:
        spec: The scene, with the table's object.
        cfg: The table.
    """
    body = spec.body(TABLE)
    if cfg.type == "wood":
        light = [float(c) for c in cfg.color]
        add_wood(spec, TABLE, light, [_GRAIN * c for c in light], planks=False)
        material = spec.material(f"{TABLE}/material")
        material.textures[_RGB] = TABLE
        material.texuniform = True
        material.rgba = [1.0, 1.0, 1.0, 1.0]  # it multiplies the texture
        material.texrepeat = 2 * [1.0 / (WOOD_LENGTH * _BOARD)]
    length, width, height = (float(x) for x in cfg.size)
    thickness = float(cfg.thickness)
    half_height = 0.5 * (height - thickness)
    if half_height < 0.01:
        return  # the table is its top alone
    spec.add_material(name=f"{TABLE}/legs", rgba=_METAL, specular=0.3, shininess=0.4)
    half_width = min(0.5 * _LEG_WIDTH, 0.25 * length, 0.25 * width)
    x = 0.5 * length - half_width
    y = 0.5 * width - half_width
    for number, (side, end) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        body.add_geom(
            name=f"{TABLE}/leg{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half_width, half_width, half_height],
            pos=[side * x, end * y, -half_height - 0.5 * thickness],
            material=f"{TABLE}/legs",
        )
    set_contact_parameters(body.geoms, object_contact(_table(cfg)))
    set_collision(body.geoms, cfg.collision)


def check_furniture(scene: SceneCfg, base: F64 | None) -> list[Problem]:
    """Return what is wrong with the table and the pedestal of a scene, with paths below it.

    Args:
        scene: The scene.
        base: (3,) position of the robot's base, or None without a robot.
    """
    problems: list[Problem] = []
    if scene.table is not None:
        height = scene.table.size[2]
        thickness = scene.table.thickness
        if thickness > height:
            message = f"at most the table's height, {height:g} m, got {thickness:g}"
            problems.append(Problem("table.thickness", message))
        problems += [p.below("table") for p in check_fixed_contact(scene.table)]
    if scene.pedestal is not None:
        mistakes = [*_check_pedestal(scene.pedestal, base), *check_fixed_contact(scene.pedestal)]
        problems += [p.below("pedestal") for p in mistakes]
    return problems


def _check_pedestal(cfg: PedestalCfg, base: F64 | None) -> list[Problem]:
    if base is None:
        missing_keys = [key for key in ("size", "pos") if getattr(cfg, key) is None]
        message = "missing value: the task has no robot to take it from"
        return [Problem(key, message) for key in missing_keys]
    foot = 0.0 if cfg.pos is None else float(cfg.pos[2])
    if cfg.size is None and not base[2] > foot:
        message = f"missing value: the robot's base, at z = {base[2]:g} m, is not above its foot"
        return [Problem("size", message)]
    if cfg.size is not None and cfg.shape == "cylinder" and cfg.size[0] != cfg.size[1]:
        message = f"a cylinder is as wide as long, got {[*cfg.size]}; or shape: box"
        return [Problem("size", message)]
    return []


def furniture_of(scene: SceneCfg, base: F64 | None) -> dict[str, RigidObjectCfg]:
    """Return the pedestal and the table as rigid objects, by uid.

    Args:
        scene: The scene.
        base: See `check_furniture`; a pedestal that it refuses has a height of 1 m here.
    """
    furniture: dict[str, RigidObjectCfg] = {}
    if scene.pedestal is not None:
        furniture[PEDESTAL] = _pedestal(scene.pedestal, np.zeros(3) if base is None else base)
    if scene.table is not None:
        furniture[TABLE] = _table(scene.table)
    return furniture


def _pedestal(cfg: PedestalCfg, base: F64) -> RigidObjectCfg:
    if cfg.pos is None:
        x, y, z = (float(base[0]), float(base[1]), 0.0)
    else:
        x, y, z = (float(p) for p in cfg.pos)
    height_of_base = float(base[2] - z)
    if not height_of_base > 0:
        height_of_base = 1.0  # `check_furniture` refuses it
    size = cfg.size or (_PEDESTAL_WIDTH, _PEDESTAL_WIDTH, height_of_base)
    length, width, height = (float(s) for s in size)
    paint = VisualMaterialCfg(base_color=[*(float(c) for c in cfg.color), 1.0])
    shape: CubeCfg | CylinderCfg
    if cfg.shape == "box":
        shape = CubeCfg(size=[length, width, height], visual_material=paint)
    else:
        shape = CylinderCfg(radius=0.5 * length, height=height, visual_material=paint)
    return RigidObjectCfg(
        shape=shape,
        attrs=RigidBodyAttributesCfg(enable_collision=cfg.collision),
        contact=_contact(cfg),
        body_type="static",
        init_pos=[x, y, z + 0.5 * height],
    )


def _contact(cfg: TableCfg | PedestalCfg) -> ContactCfg:
    """The contact parameters alone."""
    names = [field.name for field in dataclasses.fields(ContactCfg)]
    return ContactCfg(**{name: getattr(cfg, name) for name in names})


def _table(cfg: TableCfg) -> RigidObjectCfg:
    """The table's top; `finish_table` adds the rest."""
    length, width, height = (float(x) for x in cfg.size)
    x, y, z = (float(p) for p in cfg.pos)
    thickness = float(cfg.thickness)
    attrs = RigidBodyAttributesCfg(enable_collision=cfg.collision)
    paint = VisualMaterialCfg(base_color=[*(float(c) for c in cfg.color), 1.0], roughness=0.7)
    return RigidObjectCfg(
        shape=CubeCfg(size=[length, width, thickness], visual_material=paint),
        attrs=attrs,
        contact=_contact(cfg),
        body_type="static",
        init_pos=[x, y, z + height - 0.5 * thickness],
    )
