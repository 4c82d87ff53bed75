"""The entities of a scene for references: `known_entities`; `place_of`, where a frame is fixed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.names import (
    FrameKind,
    Jointed,
    KnownObject,
    ObjectModel,
    find_frame_of,
    frame_in_model,
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

_CompileAlone = Callable[[], ObjectModel | None]


class Place(NamedTuple):
    """Where something is fixed.

    Attributes:
        body: A body's name in the scene.
        pos: (3,) metres, in the body's frame.
        quat: (4,) wxyz, in the body's frame.
    """

    body: str
    pos: F64
    quat: F64

    @property
    def is_origin(self) -> bool:
        """Whether it is the body's own frame, as that of a link."""
        return not self.pos.any() and bool((self.quat == _UNTURNED).all())


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
    entities: dict[str, Jointed | KnownObject | str | None] = dict(articulations)
    for uid, cfg in objects.items():
        table_cfg = table if uid == "table" else None
        known_object = KnownObject(
            uid=uid,
            body=uid,
            prefix=f"{uid}/",
            compile_alone=_object_alone(uid, cfg, table_cfg),
        )
        entities.setdefault(uid, known_object)
    for uid in lights:
        entities.setdefault(uid, "light")
    if world is not None:
        for uid in world.objects:
            entities[uid] = KnownObject(
                uid=uid,
                body=f"{PREFIX}{uid}",
                prefix=PREFIX,
                compile_alone=_object_in_world(uid, world),
            )
    return entities


def _object_alone(uid: str, cfg: RigidObjectCfg, table: TableCfg | None) -> _CompileAlone:
    """Return a function that compiles an object alone, once."""

    @cache
    def compile_alone() -> ObjectModel | None:
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
        return ObjectModel(model, int(model.body(uid).id), f"{uid}/")

    return compile_alone


def _object_in_world(uid: str, world: World) -> _CompileAlone:
    """Return a function that finds an object in the model of the scene's file."""

    def find_in_file() -> ObjectModel:
        return ObjectModel(world.model, int(world.model.body(uid).id), "")

    return find_in_file


def place_of(entity: Jointed | KnownObject | str, uid: str, kind: FrameKind, name: str) -> Place:
    """Where a frame of an entity is fixed in the compiled scene, as the file has it.

    Args:
        entity: The entity, of `known_entities`.
        uid: Its uid.
        kind: The kind.
        name: The frame, of `frame_names`.
    """
    if kind == "link" or not isinstance(entity, (KnownObject, ParsedArticulation)):
        body = frame_in_model(entity, uid, "link", name)
        return Place(body, np.zeros(3), _UNTURNED.copy())
    if isinstance(entity, ParsedArticulation):
        body, pos, quat = local_pose(entity.model, kind, name)
        if body != "world":
            body = f"{uid}/{body}"
        return Place(body, pos, quat)
    alone = entity.compile_alone()
    if alone is None:
        raise ValueError(f"{uid!r} is not known: its config is wrong")
    body, pos, quat = local_pose(alone.model, kind, f"{alone.prefix}{name}")
    if body == alone.model.body(alone.body_id).name:
        return Place(entity.body, pos, quat)
    return Place(f"{entity.prefix}{body}", pos, quat)


def find_place(name: str, known: Known) -> tuple[Place | None, list[Problem]]:
    """Where ``ENTITY/NAME`` is fixed, NAME being a link, a site or a geom; None if nothing is.

    The problem is that the entity has no such frame; without such an entity there is none.

    Args:
        name: The name; `find_frame_of` says how NAME is understood.
        known: The entities of the scene.
    """
    uid, slash, rest = name.partition("/")
    entity = known.get(uid)
    if not slash or entity is None or isinstance(entity, str):
        return None, []
    frame, problems = find_frame_of(entity, uid, rest)
    if frame is None:
        return None, problems
    kind, frame_name = frame
    return place_of(entity, uid, kind, frame_name), problems
