"""The entities of a scene for references: `known_entities`; `place_of`, where a frame is fixed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.names import (
    FrameKind,
    Jointed,
    KnownObject,
    find_frame,
    frame_in_model,
    frame_names,
)
from embodichain.lab.sim.compiler.robot.files.robot_files import MUJOCO_ERRORS, compile_quietly
from embodichain.lab.sim.compiler.robot.files.spec_frames import local_pose
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.rigid_objects import add_object, check_object
from embodichain.lab.sim.compiler.scene.world import PREFIX, World
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import RigidObjectCfg
    from embodichain.lab.sim.compiler.index import F64
    from embodichain.lab.sim.compiler.names import Known
    from embodichain.lab.sim.configs.scene_cfg import TableCfg

__all__ = ["Place", "find_place", "known_entities", "place_of"]

_Alone = Callable[[], "tuple[mujoco.MjModel, int, str] | None"]
Place = tuple[str, "F64", "F64"]
"""A body's name in the scene, and position (3,) in metres and wxyz orientation in its frame."""

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def known_entities(
    articulations: Mapping[str, ParsedArticulation | None],
    objects: Mapping[str, RigidObjectCfg],
    lights: Mapping[str, object],
    world: World | None,
    table: TableCfg | None = None,
) -> dict[str, Jointed | KnownObject | str | None]:
    """Return what references may name: robots and articulations, objects, lights.

    Args:
        articulations: Robots and other articulations by uid; None if unreadable.
        objects: Rigid objects by uid, those of the world left out.
        lights: Lights by uid.
        world: The scene's file.
        table: The scene's table, whose object is in `objects`.
    """
    found: dict[str, Jointed | KnownObject | str | None] = dict(articulations)
    for uid, cfg in objects.items():
        own = table if uid == "table" else None
        found.setdefault(uid, KnownObject(uid, uid, f"{uid}/", _object_alone(uid, cfg, own)))
    for uid in lights:
        found.setdefault(uid, "light")
    for uid in () if world is None else world.objects:
        found[uid] = KnownObject(uid, f"{PREFIX}{uid}", PREFIX, _inside(uid, world))
    return found


def _object_alone(uid: str, cfg: RigidObjectCfg, table: TableCfg | None) -> _Alone:
    """Compile an object alone, once."""

    @cache
    def alone() -> tuple[mujoco.MjModel, int, str] | None:
        if check_object(cfg):
            return None
        spec = mujoco.MjSpec()
        add_object(spec, uid, cfg, 0)
        if table is not None:
            from embodichain.lab.sim.compiler.scene.furniture import (
                finish_table,  # few scenes have one
            )

            finish_table(spec, table)
        try:
            model = compile_quietly(spec)
        except MUJOCO_ERRORS:  # said when the scene is compiled
            return None
        return model, int(model.body(uid).id), f"{uid}/"

    return alone


def _inside(uid: str, world: World | None) -> _Alone:
    def alone() -> tuple[mujoco.MjModel, int, str] | None:
        return None if world is None else (world.model, int(world.model.body(uid).id), "")

    return alone


def place_of(entity: Jointed | KnownObject | str, uid: str, kind: FrameKind, name: str) -> Place:
    """Where a frame of an entity is fixed in the compiled scene, as the file has it.

    Args:
        entity: The entity, of `known_entities`.
        uid: Its uid.
        kind: The kind.
        name: The frame, of `frame_names`.
    """
    if kind != "link" and isinstance(entity, KnownObject):
        compiled = entity.alone()
        if compiled is None:
            raise ValueError(f"{uid!r} is not known: its config is wrong")
        model, top, prefix = compiled
        body, pos, quat = local_pose(model, kind, f"{prefix}{name}")
        is_root = body == model.body(top).name
        return (entity.body if is_root else f"{entity.prefix}{body}"), pos, quat
    if kind != "link" and isinstance(entity, ParsedArticulation):
        body, pos, quat = local_pose(entity.model, kind, name)
        return ("world" if body == "world" else f"{uid}/{body}"), pos, quat
    return frame_in_model(entity, uid, "link", name), np.zeros(3), _UNTURNED.copy()


def find_place(name: str, known: Known) -> tuple[Place | None, list[Problem]]:
    """Where ``ENTITY/NAME`` is fixed, NAME being a link, a site or a geom; None if nothing is.

    The problem is that the entity has no such frame; without such an entity there is none.

    Args:
        name: The name; `find_frame` says how NAME is understood.
        known: The entities of the scene.
    """
    uid, slash, rest = name.partition("/")
    entity = known.get(uid)
    if not slash or entity is None or isinstance(entity, str):
        return None, []
    frame, problems = find_frame(rest, lambda kind: frame_names(entity, uid, kind), "", uid)
    return (None if frame is None else place_of(entity, uid, *frame)), problems
