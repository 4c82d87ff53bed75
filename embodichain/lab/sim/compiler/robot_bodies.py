"""Bodies of an articulation: its root, and which of its shapes collide and are drawn."""

from __future__ import annotations

import mujoco

from embodichain.lab.sim.cfg import ArticulationCfg, RigidBodyAttributesCfg
from embodichain.utils.errors import ConfigError

__all__ = [
    "COLLISION_GROUP",
    "MAX_MASKED",
    "ROOT_NAME",
    "VISUAL_GROUP",
    "prepare_shapes",
    "separate",
    "set_root",
    "strip_world",
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


ROOT_NAME = "root"
"""Name of the body added where a file's world holds several bodies, or one that moves on joints."""

_FREE = mujoco.mjtJoint.mjJNT_FREE


def strip_world(spec: mujoco.MjSpec) -> list[str]:
    """Take out of a robot file what belongs to a scene: lights, and planes in its world.

    The scene has its own lights and ground. Other shapes of the file's world stay.

    Returns:
        One line about planes that were taken out, or nothing.
    """
    for light in list(spec.lights):
        spec.delete(light)
    planes = [g for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    names = ", ".join(repr(plane.name) for plane in planes)
    for plane in planes:
        spec.delete(plane)
    return [f"planes {names} of its world left out: the scene has its own ground"] if planes else []


def set_root(spec: mujoco.MjSpec, fixed: bool) -> tuple[mujoco.MjSpec, str]:
    """Make the root a mocap body or a free one; return the spec to use from now on and its name.

    A fixed base is a mocap body: its pose is then plain state, different in every environment. It
    has no degrees of freedom, so physics is that of a body fixed to the world, but for one thing:
    MuJoCo lets the children of a fixed body collide with it, and not those of a mocap body. Shapes
    that overlap at the first joint therefore do no harm here.

    Raises:
        ConfigError: If the file holds nothing, or several bodies of which one floats.
    """
    tops = list(spec.worldbody.bodies)
    if not tops:
        raise ConfigError("the file holds no bodies")
    root = tops[0]
    floats = any(j.type == _FREE for body in tops for j in body.joints)
    if floats and len(tops) > 1:
        names = ", ".join(repr(body.name) for body in tops)
        raise ConfigError(f"one articulation is one tree, but the file holds free bodies: {names}")
    if not floats and (len(tops) > 1 or root.joints):
        spec, root = _wrapped(spec)
    for joint in list(root.joints):
        spec.delete(joint)
    root.mocap = fixed
    if not fixed:
        root.add_freejoint(name="free")
    return spec, root.name


def _wrapped(spec: mujoco.MjSpec) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """Hang the whole world of a spec on a new body of a new spec."""
    for body in spec.worldbody.bodies:
        body.mocap = False
    outer = mujoco.MjSpec()
    outer.compiler.fusestatic = False
    name = ROOT_NAME
    while spec.body(name) is not None:
        name = f"{name}_"
    root = outer.worldbody.add_body(name=name)
    outer.option = spec.option
    outer.attach(spec, frame=root.add_frame(), prefix="")
    return outer, root
