"""Masses and inertias of a file's bodies, where the scene would compile others from its elements.

MuJoCo scales to `settotalmass` only the model that is compiled, not one that is attached to it, and
computes the inertia of some meshes (``inertia="convex"``) from a hull whose vertices are limited.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.geoms.shape_geoms import HULL_VERTICES

__all__ = ["HullLimit", "keep_inertias", "limit_hulls"]

_ALWAYS = 1
"""`inertiafromgeom`: of all bodies."""
_AUTO = 2
"""`inertiafromgeom`: only of bodies without an inertia of their own."""


@dataclass(frozen=True)
class HullLimit:
    """A mesh whose convex hull, which collides, has fewer vertices than in its file.

    Attributes:
        mesh: Its name.
        vertices: How many its hull has without a limit.
    """

    mesh: str
    vertices: int

    @property
    def text(self) -> str:
        """One line about it."""
        return f"mesh {self.mesh!r}: its hull of {self.vertices} vertices has {HULL_VERTICES} here"


def limit_hulls(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[HullLimit]:
    """Limit the convex hulls of meshes that have no limit of their own.

    Args:
        spec: The file; it changes.
        model: The file, compiled before.

    Returns:
        The meshes whose hull changes.
    """
    limited: list[HullLimit] = []
    for mesh in spec.meshes:
        if mesh.maxhullvert >= 0 or mesh.plugin.active:  # a distance field needs no hull
            continue
        mesh.maxhullvert = HULL_VERTICES
        start = int(model.mesh_graphadr[model.mesh(mesh.name).id])
        vertices = int(model.mesh_graph[start]) if start >= 0 else 0
        if vertices > HULL_VERTICES:
            limited.append(HullLimit(mesh.name, vertices))
    return limited


def keep_inertias(spec: mujoco.MjSpec, model: mujoco.MjModel, limited: list[HullLimit]) -> None:
    """Write the compiled masses and inertias into a file's bodies, where they would change.

    Args:
        spec: The file; it changes.
        model: The file, compiled before it was changed.
        limited: Meshes whose hull changed.
    """
    is_scaled = spec.compiler.settotalmass > 0
    if not is_scaled and not limited:
        return
    all_from_geoms = spec.compiler.inertiafromgeom == _ALWAYS
    spec.compiler.settotalmass = -1.0
    spec.compiler.inertiafromgeom = _AUTO
    for body in spec.bodies[1:]:  # the first is the world
        compiled = model.body(body.name)
        is_from_geoms = all_from_geoms or not body.explicitinertial
        would_change = is_scaled or is_from_geoms
        if compiled.mass[0] == 0 or not would_change:
            continue
        body.explicitinertial = True
        body.mass = float(compiled.mass[0])
        body.ipos = compiled.ipos
        body.iquat = compiled.iquat
        body.inertia = compiled.inertia
        body.fullinertia = np.full(6, np.nan)
