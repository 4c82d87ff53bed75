"""`Part`: a box fixed on a body, that things are placed on, in or beside.

It is the box around a body's geoms, or a geom's, or the one that a site marks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.gym.envs.mdp._boxes import Boxes, box_around, boxes_of_geoms, solid_geoms
from embodichain.lab.sim.compiler.names import find_frame, frame_in_model, frame_names, no_such
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.names import FrameKind
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["INSIDE", "TOP", "Part", "find_part", "part_of_body"]

_BOX = 6
"""MuJoCo's ``mjGEOM_BOX``; MuJoCo itself is not imported for tables of terms."""
INSIDE = "inside"
"""The site that things `in` an entity are in."""
TOP = "top"
"""The site that things `on` an entity are on, if there is one."""


@dataclass(frozen=True)
class Part:
    """A box fixed on a body.

    Attributes:
        uid: The entity.
        body: MuJoCo's id of the body.
        kind: Whether the box is that of a site, or around geoms: one, or all of the body.
        ids: MuJoCo's ids of the site or the geoms.
    """

    uid: str
    body: int
    kind: FrameKind
    ids: tuple[int, ...]

    def read(self, engine: Engine, ids: EnvIds) -> Boxes:
        """The box in the frame of the body, (n,)."""
        numbers = np.asarray(self.ids, np.int64)
        if self.kind == "link":
            return box_around(engine, numbers, ids)
        if self.kind == "geom":
            return boxes_of_geoms(engine, numbers, ids).rows((slice(None), 0))
        site = self.ids[0]
        model = engine.model
        count = len(ids)
        axes = quat_to_matrix(model.site_quat[site][None])
        return Boxes(
            middle=np.repeat(model.site_pos[site][None], count, axis=0),
            axes=np.repeat(axes, count, axis=0),
            half=np.repeat(model.site_size[site][None], count, axis=0),
        )

    def pose(self, engine: Engine, ids: EnvIds) -> tuple[Floats, Floats]:
        """Position (n, 3) in m and rotation matrix (n, 3, 3) of the body now."""
        pos = engine.derived("xpos")[ids, self.body]
        axes = engine.derived("xmat")[ids, self.body].reshape(-1, 3, 3)
        return pos, axes

    def box_now(self, engine: Engine, ids: EnvIds) -> Boxes:
        """The box where it is now, (n,)."""
        pos, axes = self.pose(engine, ids)
        return self.read(engine, ids).moved(pos, axes)

    def across(self, engine: Engine) -> int:
        """The column of the box's axes after the one that is nearest to the vertical now."""
        box = self.box_now(engine, np.zeros(1, np.int64))
        vertical = int(np.abs(box.axes[0, 2]).argmax())
        return (vertical + 1) % 3


def part_of_body(engine: Engine, uid: str, body: int) -> Part:
    """The box around the geoms of a body."""
    return Part(uid, body, "link", tuple(solid_geoms(engine, body).tolist()))


def find_part(
    sim: SimulationManager, name: str, path: str, relation: Literal["on", "in", "beside"]
) -> Part:
    """Find what a relation names.

    Args:
        sim: The scene.
        name: ``ENTITY``, or ``ENTITY/NAME`` of a site, link or geom.
        path: Its key path.
        relation: An entity alone means its site `INSIDE` for things in it, and its site `TOP`, if
            there is one, for things on it.

    Raises:
        ConfigError: If it does not exist, or has no extent.
    """
    uid, slash, frame = name.partition("/")
    entities = {name: e for name, e in sim.known.items() if e is not None and e != "light"}
    entity = entities.get(uid)
    if entity is None:
        raise ConfigError([no_such("entity", uid, list(entities), path)])

    sites = frame_names(entity, uid, "site") or ()
    if not slash and relation == "in":
        if INSIDE not in sites:
            raise ConfigError([_no_inside(uid, sites, path)])
        frame = f"site:{INSIDE}"
    elif not slash and relation == "on" and TOP in sites:
        frame = f"site:{TOP}"
    if not frame:
        handles = {**sim.robots, **sim.articulations, **sim.rigid_objects}
        part = part_of_body(sim.engine, uid, int(handles[uid].entity.root_body_id))
        return _with_extent(part, sim.engine.model, name, path)

    found, problems = find_frame(frame, lambda kind: frame_names(entity, uid, kind), path, uid)
    if found is None:
        raise ConfigError(problems)
    kind, frame_name = found
    name_in_model = frame_in_model(entity, uid, kind, frame_name)
    model = sim.engine.model
    if kind == "link":
        part = part_of_body(sim.engine, uid, int(model.body(name_in_model).id))
    else:
        element = model.site(name_in_model) if kind == "site" else model.geom(name_in_model)
        part = Part(uid, int(element.bodyid[0]), kind, (int(element.id),))
    return _with_extent(part, model, name, path)


def _no_inside(uid: str, sites: tuple[str, ...], path: str) -> Problem:
    message = (
        f"{uid!r} has no inside: no site of it is called {INSIDE!r}; its sites: "
        f"{', '.join(sites) or 'none'}"
    )
    return Problem(path, message, "An object declares it in `sites`, with a size.")


def _with_extent(part: Part, model: mujoco.MjModel, name: str, path: str) -> Part:
    """Return a part that has length and width.

    Raises:
        ConfigError: If it has none.
    """
    if part.kind == "site":
        is_box = model.site_type[part.ids[0]] == _BOX
        if not is_box:
            message = f"the site {name!r} is a point, not a box: give it a size"
            raise ConfigError([Problem(path, message)])
    elif not part.ids:
        message = f"{name!r} has no shape of its own: name a link, site or geom of it"
        raise ConfigError([Problem(path, message)])
    return part
