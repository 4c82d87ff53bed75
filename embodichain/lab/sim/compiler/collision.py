"""What of an articulation collides with what, and what is drawn. Masks and groups only."""

from __future__ import annotations

import mujoco

from embodichain.lab.sim.cfg import ArticulationCfg, RigidBodyAttributesCfg

__all__ = [
    "COLLISION_GROUP",
    "MAX_MASKED",
    "VISUAL_GROUP",
    "prepare_shapes",
    "separate",
]

VISUAL_GROUP = 2
"""Group of visual shapes; MuJoCo draws groups 0 to 2 unless told otherwise."""
COLLISION_GROUP = 3
"""Group of collision shapes of links that have visual ones: not drawn."""
MAX_MASKED = 30
"""Articulations without self-collision in one scene: a contype bit each; bit 0 is all others'."""
_HULL_VERTICES = 64
_ALL_BITS = 0x7FFFFFFF


def collides(geom: mujoco.MjsGeom) -> bool:
    """Whether a geom takes part in collision."""
    return bool(geom.contype or geom.conaffinity)


def prepare_shapes(spec: mujoco.MjSpec, cfg: ArticulationCfg, is_urdf: bool) -> None:
    """Group a file's shapes into drawn and colliding ones, and apply the config's attributes.

    URDF has no friction: `attrs.dynamic_friction` is it. An MJCF keeps its own unless the config's
    differs from the default.
    """
    friction = float(cfg.attrs.dynamic_friction)
    if is_urdf or friction != RigidBodyAttributesCfg().dynamic_friction:
        for geom in spec.geoms:
            geom.friction[0] = friction
    if not cfg.attrs.enable_collision:
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
    for mesh in spec.meshes:
        if mesh.maxhullvert < 0:
            mesh.maxhullvert = _HULL_VERTICES
    if is_urdf:
        for body in spec.bodies:
            _group_by_use(list(body.geoms))


def _group_by_use(geoms: list[mujoco.MjsGeom]) -> None:
    # MuJoCo's URDF reader gives visual shapes no contact bits and group 1; a URDF collision shape
    # whose collision the config switched off is told apart by its group 0.
    visual = [geom for geom in geoms if geom.group == 1]
    for geom in geoms:
        if geom.group == 1:
            geom.group = VISUAL_GROUP
        elif visual:
            geom.group = COLLISION_GROUP


def separate(spec: mujoco.MjSpec, number: int) -> None:
    """Keep the shapes of a spec from colliding with each other, and with nothing else changed.

    Two geoms collide if one's contype meets the other's conaffinity: each articulation has its own
    contype bit and accepts all bits but that one.

    Args:
        spec: The articulation.
        number: 1 to `MAX_MASKED`, another one for each articulation.
    """
    bit = 1 << number
    for geom in spec.geoms:
        if collides(geom):
            geom.contype, geom.conaffinity = bit, _ALL_BITS & ~bit
