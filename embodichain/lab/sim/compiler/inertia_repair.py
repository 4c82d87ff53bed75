"""Inertias of a file that no rigid body can have, made possible, and named."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.collision import collides
from embodichain.lab.sim.compiler.index import F64
from embodichain.utils.math import quat_multiply

__all__ = ["repair_inertias"]

_LEAST_MASS = 1e-6  # kg
_LEAST_INERTIA = 1e-9  # kg m^2


def repair_inertias(spec: mujoco.MjSpec) -> str:
    """Let MuJoCo's compiler repair inertias, and principal moments below zero here.

    MuJoCo raises masses to 1e-6 kg and moments to 1e-9 kg m^2 and, where the largest moment is more
    than the sum of the others, makes all three their mean (``boundmass``, ``boundinertia``,
    ``balanceinertia``). It refuses a tensor with a negative eigenvalue: that is raised to 1e-9.

    Args:
        spec: Edited in place.

    Returns:
        One line that names the links, without the file.
    """
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = _LEAST_MASS
    spec.compiler.boundinertia = _LEAST_INERTIA
    # By way of the spec: `body.joints` raises the error of a compilation that failed before.
    moving = {joint.parent.name for joint in spec.joints}
    shaped = {geom.parent.name for geom in spec.geoms if collides(geom)}
    names = []
    for body in spec.bodies[1:]:  # the first is the world
        if not body.explicitinertial:
            if body.name in moving - shaped:
                names.append(body.name)  # it moves, and weighs nothing
            continue
        moments, axes = _principal(body)
        if not (body.name in moving or body.mass or moments.any()):
            continue  # a frame without mass, which is fixed
        low = moments.min() < _LEAST_INERTIA
        if low or body.mass < _LEAST_MASS or 2.0 * moments.max() > moments.sum():
            names.append(body.name)
        if low and np.isfinite(body.fullinertia[0]):
            body.fullinertia = np.full(6, np.nan)
            body.inertia = np.maximum(moments, _LEAST_INERTIA)
            body.iquat = quat_multiply(np.asarray(body.iquat, np.float64), axes)
    return (
        f"masses or inertias that no body can have are repaired (at least {_LEAST_MASS:g} kg and "
        f"{_LEAST_INERTIA:g} kg m^2, balanced moments): {', '.join(names)}"
    )


def _principal(body: mujoco.MjsBody) -> tuple[F64, F64]:
    """Return (3,) principal moments, and the orientation of their axes, wxyz."""
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    xx, yy, zz, xy, xz, yz = np.asarray(body.fullinertia, np.float64)
    if not np.isfinite(xx):
        return np.asarray(body.inertia, np.float64), quat
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    mujoco.mju_mat2Quat(quat, axes.ravel())
    return moments, quat
