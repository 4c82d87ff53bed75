"""What an articulation stands on: a mocap body (fixed base) or a free joint (floating base)."""

from __future__ import annotations

import mujoco

from embodichain.utils.errors import ConfigError

__all__ = ["ROOT_NAME", "set_root", "strip_world"]

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
