"""`collision_shapes` of an articulation: links that collide as a primitive shape, or not at all.

A primitive has one contact with a plane where the hull of a mesh has several, and it is found
without a search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, CollisionShapeCfg, RigidBodyAttributesCfg
from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    ContactParameters,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.geoms.shape_geoms import (
    COLLISION_GROUP,
    add_shape,
    check_geometry,
    collides,
)
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.shapes import MeshCfg, PlaneCfg
from embodichain.utils.errors import Problem

__all__ = ["replace_shapes", "resolve_shapes"]

_UNSCALED = np.ones(3)


def resolve_shapes(
    links: Sequence[str], cfg: ArticulationCfg
) -> tuple[dict[str, CollisionShapeCfg | None], list[Problem]]:
    """Return the shape of each link that `collision_shapes` names, and every mistake.

    Args:
        links: The articulation's links.
        cfg: Its config; paths of mistakes begin with ``collision_shapes``.
    """
    shapes: dict[str, CollisionShapeCfg | None] = {}
    problems: list[Problem] = []
    pattern_of: dict[str, str] = {}
    if cfg.collision_shapes and not cfg.attrs.enable_collision:
        message = "attrs.enable_collision is false: no link collides"
        problems.append(Problem("collision_shapes", message))
    for pattern, shape in cfg.collision_shapes.items():
        path = f"collision_shapes.{pattern}"
        ids, mistakes = match(pattern, links, "link", path)
        problems += mistakes
        if shape is not None:
            problems += [p.below(path) for p in _check(shape)]
        for i in ids:
            link = links[i]
            if link in pattern_of:
                message = f"{pattern_of[link]!r} matches link {link!r} too"
                problems.append(Problem(path, message))
            pattern_of[link] = pattern
            shapes[link] = shape
    return shapes, problems


def _check(cfg: CollisionShapeCfg) -> list[Problem]:
    if isinstance(cfg.shape, PlaneCfg | MeshCfg):
        message = f"a {cfg.shape.shape_type} cannot replace a link's shapes"
        allowed = "allowed: Capsule, Cube, Cylinder, Sphere"
        return [Problem("shape.shape_type", f"{message}; {allowed}")]
    return [*check_geometry(cfg.shape, _UNSCALED), *check_pose(cfg)]


def replace_shapes(
    spec: mujoco.MjSpec,
    shapes: Mapping[str, CollisionShapeCfg | None],
    attrs: RigidBodyAttributesCfg,
) -> None:
    """Switch off the colliding geoms of links, and add a geom without mass for each shape.

    A geom ``LINK/collision/geom`` has the contact parameters of the link's first geom that
    collided. The geoms that were switched off keep their mass.

    Args:
        spec: The articulation.
        shapes: Link -> shape, from `resolve_shapes`; None: the link collides with nothing.
        attrs: Gives the friction of links that had no colliding geom.
    """
    for number, (name, cfg) in enumerate(shapes.items()):
        body = spec.body(name)
        replaced_geoms = [geom for geom in body.geoms if collides(geom)]
        if cfg is not None:
            geom = add_shape(spec, body, f"{name}/collision", cfg.shape, _UNSCALED, number)
            geom.pos, geom.quat = initial_pose(cfg)
            geom.mass = 0.0
            geom.group = COLLISION_GROUP
            geom.friction[0] = float(attrs.dynamic_friction)
            if replaced_geoms:
                set_contact_parameters([geom], ContactParameters.of_geom(replaced_geoms[0]))
        for geom in replaced_geoms:
            geom.contype = geom.conaffinity = 0
